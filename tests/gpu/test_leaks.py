"""Rays from inside closed bodies: none may get out. And the control, Moeller-Trumbore, which must let some out.

Woop, Benthin & Wald, "Watertight Ray/Triangle Intersection", JCGT 2(1) 2013, on edges and, what most tracers' own tests
leave out, on vertices. GLHYBRID_TEST_SCALE=100 is the full run: 10^6 rays of each kind and place.
"""

from typing import TYPE_CHECKING

import numpy as np
import pytest
import rays as ray
from rays import EMBREE_FAR, Rays, Tracer, moved, piece, scene_of

from glhybrid.scene import F64, U32, Scene

if TYPE_CHECKING:
    from glhybrid.context import Context

BODIES: dict[str, tuple[F64, U32]] = {
    "sphere 20": ray.uv_sphere(20),
    "sphere 200": ray.uv_sphere(200),
    "jagged": ray.jagged(40, np.random.default_rng(1)),
    "drum": ray.drum(60),
}
PLACES = (
    "near",
    "moved far",
    "baked far",
)  # at 0; put there by a float64 transform; in the float32 vertices themselves
AIMS = ("vertex", "edge", "random")


def _scene(body: str, place: str) -> tuple[Scene, F64]:
    """The body, and its vertices in the world, float64."""
    position, index = BODIES[body]
    if place == "baked far":
        baked = (position + EMBREE_FAR).astype(np.float32)
        return scene_of(piece(baked, index)), baked.astype(np.float64)
    # Turned, so that nothing is parallel to an axis once it is placed, in one level and in two.
    turn = ray.rotation(np.random.default_rng(7)) if place == "moved far" else np.eye(3)
    offset = EMBREE_FAR if place == "moved far" else np.zeros(3)
    vertex = position.astype(np.float32).astype(np.float64) @ turn.T + offset
    return scene_of(piece(position, index), poses=[moved(offset, turn)]), vertex


def _aimed(aim: str, vertex: F64, index: U32, n: int, rng: np.random.Generator) -> Rays:
    """From points near the middle, on a grid of 1/64 m that float32 holds even far from zero, at vertices and edges."""
    origin = rng.integers(-16, 17, (n, 3)) / 64
    if aim == "random":
        return Rays.make(origin, ray.sphere_directions(rng, n))
    row = index[rng.integers(0, len(index), n)]
    corner = rng.integers(0, 3, n)
    target = vertex[row[np.arange(n), corner]]
    if aim == "edge":
        target = target + rng.random((n, 1)) * (vertex[row[np.arange(n), (corner + 1) % 3]] - target)
    return Rays.make(origin, ray.unit(target - origin))


@pytest.mark.parametrize("levels", [1, 2])
@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("body", BODIES)
def test_no_ray_leaves_a_closed_body(context: "Context", body: str, place: str, levels: int) -> None:
    rng = np.random.default_rng(12)
    scene, vertex = _scene(body, place)
    with Tracer(context, scene, levels, origin=np.round(vertex.mean(0) * 64) / 64) as tracer:
        assert tracer.geometry.dropped > 0.1 * len(BODIES[body][1]) or (body, place) != ("sphere 200", "baked far")
        for aim in AIMS:
            leaked = total = 0
            while total < (n := ray.count(1_000_000)):
                rays = _aimed(aim, vertex - tracer.origin, BODIES[body][1], min(n - total, 250_000), rng)
                found = tracer.trace(rays)
                total += len(rays)
                leaked += int((~found.hit | ~found.blocked).sum())
            ray.say(f"{body:10} {place:9} levels {levels} {aim:6} {leaked} of {total}")
            assert leaked == 0, (aim, total)


@pytest.mark.parametrize("body", ["sphere 20", "jagged"])
@pytest.mark.parametrize(
    ("place", "levels"), [("near", 1), ("near", 2), ("moved far", 1), ("moved far", 2), ("baked far", 1)]
)
def test_the_control_leaks(context: "Context", body: str, place: str, levels: int) -> None:
    """The same rays through the test that is not watertight, so that the test above is known to see a leak."""
    rng = np.random.default_rng(12)
    scene, vertex = _scene(body, place)
    with Tracer(context, scene, levels, origin=np.round(vertex.mean(0) * 64) / 64, moeller_trumbore=True) as tracer:
        n = ray.count(100_000)
        for aim in ("vertex", "edge"):
            found = tracer.trace(_aimed(aim, vertex - tracer.origin, BODIES[body][1], n, rng))
            ray.say(
                f"{body:10} {place:9} levels {levels} {aim:6} {(~found.hit).mean():.2%} leak through Moeller-Trumbore"
            )
            assert (~found.hit).mean() > 0.01 and (~found.blocked).mean() > 0.01


def test_no_ray_leaves_a_fan_through_its_hub(context: "Context") -> None:
    """Vertices where hundreds of thin triangles meet, and rays exactly through them, through edges and along axes."""
    position, index = ray.drum(720)
    position = (
        np.round(position * 256) / 256
    )  # exact in float32 after any of the offsets below: rays meet points exactly
    scene = scene_of(piece(position, index))
    with Tracer(context, scene, 1, origin=(0, 0, 0)) as tracer:
        axis = np.concatenate([np.eye(3), -np.eye(3)])
        diagonal = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
        exact = position[np.linalg.norm(position, axis=1) > 0]
        directions = np.concatenate([axis, diagonal, exact, -exact, exact * (1, 0, 1), exact * (1, 1, 0)])
        directions = directions[(directions != 0).any(1)]
        found = tracer.trace(Rays.make(np.zeros(3), directions))
        assert found.hit.all() and found.blocked.all()

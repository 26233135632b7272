"""The parts of a scene file that stand alone: camera, light, studio, transform, parameters of shapes and patterns."""

from dataclasses import replace
from typing import Any

import numpy as np

from glhybrid.load import sky
from glhybrid.load.tables import LIGHT, NOT_NEGATIVE, PLACE, POSITIVE, SCALE, UNIT, Table, between
from glhybrid.scene import F32, F64, Camera, Light, Probe


def parameters(table: Table, defaults: dict[str, Any]) -> dict[str, Any]:
    """The parameters of a shape or pattern that are given, checked by the type of their default."""
    given: dict[str, Any] = {}
    for key, default in defaults.items():
        if key not in table:
            continue
        if isinstance(default, bool):
            given[key] = table.boolean(key, default)
        elif isinstance(default, int):
            given[key] = table.integer(key, default, 0)
        elif isinstance(default, float):
            given[key] = table.number(key, default)
        elif isinstance(default, str):
            given[key] = table.string(key, default)
        elif isinstance(default[0], int):
            values = table.vector(key, default, (lambda x: x == int(x) and x >= 0, "must be whole numbers"))
            given[key] = tuple(int(x) for x in values)
        elif isinstance(default[0], float):
            given[key] = table.vector(key, default)
        else:
            given[key] = table.raw(key)  # a list of points: the shape checks it
    return given


def camera(name: str, table: Table) -> Camera:
    """A [camera.NAME] table. Raises LoadError naming table and key."""
    for key in ("eye", "target"):
        table.need(key, f"needs {key} = [x, y, z]")
    eye, target = (three(table.vector(key, (0, 0, 0), PLACE)) for key in ("eye", "target"))
    up = three(table.vector("up", (0, 1, 0)))
    height = table.number("height", 0.0, POSITIVE)
    if height and "fov_y_deg" in table:
        table.fail("is of an orthographic camera; give either height or fov_y_deg", "height")
    fov_y = np.radians(table.number("fov_y_deg", 45.0, (lambda x: 0 < x < 180, "must be between 0 and 180")))
    near = table.number("near", 0.01, POSITIVE)
    if eye == target:
        table.fail("must not be where the eye is", "target")
    if not any(up):
        table.fail("must not be zero", "up")
    table.finish()
    made = Camera.look_at(eye, target, up, float(fov_y), near, name)
    return replace(made, fov_y=0.0, ymag=height / 2) if height else made


def probe(table: Table) -> Probe:
    """A place for a reflection probe, in the box it speaks for; without a position in the middle of it."""
    for key in ("min", "max"):
        table.need(key, f"a probe needs {key} = [x, y, z], a corner of the box it speaks for")
    low, high = (three(table.vector(key, (0, 0, 0), PLACE)) for key in ("min", "max"))
    middle = three(tuple((a + b) / 2 for a, b in zip(low, high, strict=True)))
    position = three(table.vector("position", middle, PLACE))
    if not all(a < b for a, b in zip(low, high, strict=True)):
        table.fail("must be larger than min along every axis", "max")
    if not all(a < p < b for a, p, b in zip(low, position, high, strict=True)):
        table.fail("must lie inside the box from min to max", "position")
    made = Probe(position, low, high, table.string("name", ""))
    table.finish()
    return made


def light(table: Table) -> Light:
    """A [[light]] table. Raises LoadError naming table and key."""
    table.need("kind", 'needs kind = "directional", "point" or "spot"')
    kind: Any = table.string("kind", "", ("directional", "point", "spot"))
    plain = Light(kind)
    fields: dict[str, Any] = {}
    if kind != "directional":
        table.need("position", f"a {kind} light needs position = [x, y, z]")
        fields["position"] = three(table.vector("position", plain.position, PLACE))
        fields["radius"] = table.number("radius", 0.0, NOT_NEGATIVE)
        fields["range"] = table.number("range", 0.0, NOT_NEGATIVE)
    else:
        fields["angular_diameter"] = np.radians(
            table.number("angular_diameter_deg", 0.0, (lambda x: 0 <= x < 180, "must be at least 0 and less than 180"))
        )
    if kind != "point":
        direction = np.array(table.vector("direction", plain.direction))
        length = float(np.linalg.norm(direction))
        if not 1e-150 < length < np.inf:
            table.fail("must not be zero: it is the way the light travels", "direction")
        fields["direction"] = three(tuple(float(x) for x in direction / length))
    if kind == "spot":
        inner = table.number("inner_cone_deg", 0.0, between(0, 90))
        outer = table.number("outer_cone_deg", 45.0, between(0, 90))
        if inner >= outer:
            table.fail(
                f"inner_cone_deg = {inner:g}: must be less than outer_cone_deg ({outer:g}); both are half angles"
            )
        fields["inner_cone"], fields["outer_cone"] = np.radians(inner), np.radians(outer)
    light = Light(
        kind,
        color=three(table.vector("color", plain.color, LIGHT)),
        intensity=table.number("intensity", 1.0, LIGHT),
        name=table.string("name", ""),
        **fields,
    )
    for key in table.values:
        if key not in table.known and key in _LIGHT_KEYS:
            table.fail(f"does not apply to a {kind} light", key)
    table.finish()
    return light


_LIGHT_KEYS = frozenset({"position", "direction", "radius", "angular_diameter_deg", "range", "inner_cone_deg",
                         "outer_cone_deg"})  # fmt: skip


def studio(parent: Table) -> F32:
    """Soft boxes of light around the scene, before a background that runs from floor to ceiling."""
    table = parent.table("studio")
    assert table is not None
    floor, ceiling = (table.vector(k, (0.1, 0.1, 0.1), LIGHT) for k in ("floor", "ceiling"))
    boxes = []
    for box in table.tables("boxes"):
        boxes.append(
            sky.SoftBox(
                azimuth=np.radians(box.number("azimuth_deg", 0.0)),
                elevation=np.radians(box.number("elevation_deg", 45.0, between(-90, 90))),
                size=two(np.radians(box.vector("size_deg", (30.0, 30.0), between(0.5, 170)))),
                radiance=three(box.vector("radiance", (1.0, 1.0, 1.0), LIGHT)),
                soft=box.number("soft", 0.2, UNIT),
            )
        )
        box.finish()
    table.finish()
    return sky.studio_map(boxes, three(floor), three(ceiling))


def transform(table: Table) -> F64:
    """(4, 4) translate x rotate x scale; rotate = Rz Ry Rx: about X first, then Y, then Z."""
    if type(table.raw("scale")) in (int, float):
        scale = np.full(3, table.number("scale", 1.0, SCALE))
    else:
        scale = np.array(table.vector("scale", (1.0, 1.0, 1.0), SCALE))
    (cx, cy, cz), (sx, sy, sz) = (f(np.radians(table.vector("rotate_deg", (0, 0, 0)))) for f in (np.cos, np.sin))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    world = np.eye(4)
    world[:3, :3] = about_z @ about_y @ about_x * scale
    world[:3, 3] = table.vector("translate", (0, 0, 0), PLACE)
    return world


def moved_light(light: Light, world: F64, node: int) -> Light:
    """Moved and turned; a scale changes neither intensity nor range nor size (KHR_lights_punctual)."""
    position = world[:3, :3] @ light.position + world[:3, 3]
    direction = world[:3, :3] @ light.direction
    direction /= np.linalg.norm(direction)
    return replace(
        light, position=three(tuple(position.tolist())), direction=three(tuple(direction.tolist())), node=node
    )


def moved_camera(camera: Camera, world: F64, node: int) -> Camera:
    """Moved and turned but not scaled: a view stays rigid."""
    pose = world @ camera.world_from_view
    eye, ahead = pose[:3, 3], -pose[:3, 2]
    rigid = Camera.look_at(
        three(tuple(eye)), three(tuple(eye + ahead / np.linalg.norm(ahead))), three(tuple(pose[:3, 1]))
    )
    return replace(camera, world_from_view=rigid.world_from_view, node=node)


def two(v: Any) -> tuple[float, float]:
    """The first two numbers, as a type that says how many."""
    return float(v[0]), float(v[1])


def three(v: tuple[float, ...]) -> tuple[float, float, float]:
    """The first three numbers, as a type that says how many."""
    return v[0], v[1], v[2]


def four(v: tuple[float, ...]) -> tuple[float, float, float, float]:
    """The first four numbers, as a type that says how many."""
    return v[0], v[1], v[2], v[3]

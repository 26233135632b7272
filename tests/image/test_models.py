"""Real files, small: what every pixel's surface is, recomputed in float64 from the scene that was loaded."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from bars import BARS
from compare import edges
from texture_oracle import linear, sampled, transformed

import glhybrid
from glhybrid.image import NO_ID
from glhybrid.scene import Scene, Triangles
from glhybrid.settings import Settings

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from glhybrid.renderer import Renderer

    F64 = NDArray[np.float64]

MODELS = (
    "TextureTransformTest/TextureTransformTest.gltf", "TextureSettingsTest/TextureSettingsTest.glb",
    "VertexColorTest/VertexColorTest.glb", "MultiUVTest/MultiUVTest.glb", "TextureCoordinateTest/TextureCoordinateTest.glb",
    "AlphaBlendModeTest/AlphaBlendModeTest.glb", "NegativeScaleTest/NegativeScaleTest.glb",
    "SimpleInstancing/SimpleInstancing.glb", "Box With Spaces/Box With Spaces.gltf", "TextureEncodingTest/TextureEncodingTest.glb",
    "CornellBox/CornellBox.glb",
)  # fmt: skip
WHOLE = ("Box With Spaces/Box With Spaces.gltf", "TextureEncodingTest/TextureEncodingTest.glb")
SIZE = (96, 72)


def finest(scene: Scene) -> Scene:
    """Without mip levels: what a texture is, not how it is minified."""
    materials = tuple(
        dataclasses.replace(m, textures={k: dataclasses.replace(t, mipmap=False) for k, t in m.textures.items()})
        for m in scene.materials
    )
    return scene.replace(materials=materials)


def surfaces(scene: Scene, frame: Any) -> "tuple[dict[str, F64], NDArray[np.bool_]]":
    """albedo, roughness, metallic and emissive of every covered pixel, and which pixels a texel's step makes uncertain."""
    shape = frame["instance_id"].shape
    out: dict[str, Any] = {"albedo": np.zeros((*shape, 3)), "emissive": np.zeros((*shape, 3)),
                           "roughness": np.zeros(shape), "metallic": np.zeros(shape)}  # fmt: skip
    unsure = np.zeros(shape, bool)
    for number, instance in enumerate(scene.instances):
        first = 0  # row of the primitive's first triangle, in its mesh
        for k, piece in enumerate(scene.meshes[instance.mesh].primitives):
            assert isinstance(piece, Triangles)
            row = frame["triangle_id"].astype(np.int64) - first
            pixels = (frame["instance_id"] == number) & (row >= 0) & (row < len(piece.index))
            first += len(piece.index)
            if not pixels.any():
                continue
            which = instance.materials[k] if instance.materials else piece.material
            assert (frame["material_id"][pixels] == which).all()
            material = scene.materials[which]
            index = piece.index[row[pixels]]
            world = piece.position.astype(np.float64) @ instance.world_from_object[:3, :3].T
            weights = barycentrics(world[index] + instance.world_from_object[:3, 3], frame["position"][pixels])

            def mixed(values: Any) -> "F64":
                return np.einsum("nk,nkc->nc", weights, values[index].astype(np.float64))  # noqa: B023

            def look(slot: str, srgb: bool) -> Any:
                texture = material.textures.get(slot)  # noqa: B023
                if texture is None:
                    return np.ones((1, 4))
                values = piece.uv1 if texture.uv_set == 1 else piece.uv0  # noqa: B023
                uv = mixed(values) if values is not None else np.zeros((len(index), 2))  # noqa: B023
                uv = transformed(texture, uv)
                texels = texture.image.texels
                if texture.nearest:
                    grid = uv * texels.shape[1::-1]
                    unsure[pixels] |= np.abs(grid - np.round(grid)).min(-1) < 1e-3  # noqa: B023
                return sampled(texture, linear(texels, srgb), uv)

            color = np.array(material.base_color) * look("base_color", True)
            if piece.color is not None:
                color = color * mixed(piece.color)
            mr = look("metallic_roughness", False)
            out["albedo"][pixels] = color[:, :3]
            out["roughness"][pixels] = material.roughness * mr[:, 1]
            out["metallic"][pixels] = material.metallic * mr[:, 2]
            if not material.unlit:
                out["emissive"][pixels] = np.array(material.emissive) * look("emissive", True)[:, :3]
    return out, unsure


def barycentrics(corners: "F64", points: Any) -> "F64":
    """(N, 3) weights of (N, 3, 3) corners at points in their planes."""
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    d = points.astype(np.float64) - corners[:, 0]
    a, b, c = (e1 * e1).sum(1), (e1 * e2).sum(1), (e2 * e2).sum(1)
    p, q = (d * e1).sum(1), (d * e2).sum(1)
    det = a * c - b * b
    v, w = (c * p - b * q) / det, (a * q - b * p) / det
    return np.stack([1 - v - w, v, w], 1)


@pytest.mark.parametrize("name", MODELS)
def test_surface_of_every_pixel(renderer: "Renderer", models: Path, name: str) -> None:
    scene = finest(glhybrid.load(models / name))
    keys = ("albedo", "roughness", "metallic", "emissive") if name in WHOLE else ("albedo",)  # each is a program
    aovs = ("position", *keys, "instance_id", "triangle_id", "material_id")
    frame = renderer.render(scene, size=SIZE, settings=Settings(aa=1), aovs=aovs)
    assert np.isfinite(frame["radiance"]).all()
    covered = frame["instance_id"] != NO_ID
    assert covered.mean() > 0.05
    want, unsure = surfaces(scene, frame)
    # On an outline the point is clamped into its triangle; on a texel's border float32 may fall on either side.
    keep = covered & ~unsure & ~edges(frame["instance_id"], frame["triangle_id"])
    assert keep.sum() > 100
    for key in keys:
        values = want[key]
        error = np.abs(frame[key] - values).reshape(*SIZE[::-1], -1).max(-1)[keep] / max(values.max(), 1)
        assert np.quantile(error, 0.995) < BARS["surface"].value, (
            key,
            error.max(),
            np.quantile(error, [0.5, 0.99, 0.995]),
        )


@pytest.mark.parametrize("name", ["VertexColorTest/VertexColorTest.glb"])
def test_one_and_two_levels_agree(renderer: "Renderer", models: Path, name: str) -> None:
    """Flattened or instanced, rastered or traced: one picture."""
    scene = glhybrid.load(models / name)
    ways: Any = (
        {"levels": 1, "primary": "raster"},
        {"levels": 2, "primary": "raster"},
        {"levels": 2, "primary": "trace"},
    )
    frames = [
        renderer.render(scene, size=SIZE, settings=Settings(aa=1, **given), aovs=("triangle_id",)) for given in ways
    ]
    first = frames[0]
    inner = ~edges(first["triangle_id"])
    for other in frames[1:]:
        error = np.abs(other["radiance"] - first["radiance"]).max(-1) / first["radiance"].mean()
        assert (error[inner] > BARS["same picture"].value).mean() < BARS["same picture, pixels"].value

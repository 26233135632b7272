"""The glTF reader: materials, textures and tangents, on the smallest asset that holds each."""

from pathlib import Path

import numpy as np
import pytest
from gltf_builder import Builder, load, piece, textured

from glhybrid.errors import LoadError
from glhybrid.load.gltf import load_gltf


def test_material_without_and_with_factors(tmp_path: Path) -> None:
    b = Builder()
    b.scene(b.quad(), b.quad(material=0), b.quad(material=1), b.quad())
    b.add("materials")
    b.add("materials", name="m", pbrMetallicRoughness={"baseColorFactor": [0.1, 0.2, 0.3, 0.4], "metallicFactor": 0.5,
          "roughnessFactor": 0.25}, emissiveFactor=[1, 0.5, 0], alphaMode="MASK", alphaCutoff=0.7, doubleSided=True,
          extensions={"KHR_materials_emissive_strength": {"emissiveStrength": 4}, "KHR_materials_unlit": {},
                      "KHR_materials_ior": {"ior": 1.33}, "KHR_materials_transmission": {"transmissionFactor": 0.9},
                      "KHR_materials_specular": {"specularFactor": 0.3, "specularColorFactor": [2, 1, 0]},
                      "KHR_materials_clearcoat": {
                          "clearcoatFactor": 0.6, "clearcoatRoughnessFactor": 0.2}})  # fmt: skip
    scene = load(b, tmp_path)
    none, default, full = scene.materials
    assert (none.metallic, none.roughness, none.base_color) == (0.0, 1.0, (1.0,) * 4)  # no material at all
    assert (default.metallic, default.roughness) == (1.0, 1.0)  # glTF's own default
    assert [p.material for p in scene.meshes[0].primitives] == [0, 1, 2, 0]
    assert full.base_color == (0.1, 0.2, 0.3, 0.4) and (full.metallic, full.roughness) == (0.5, 0.25)
    assert full.emissive == (4.0, 2.0, 0.0) and (full.alpha_mode, full.alpha_cutoff) == ("MASK", 0.7)
    assert full.double_sided and full.unlit and full.ior == 1.33 and full.transmission == 0.9 and full.name == "m"
    assert (full.specular, full.specular_color) == (0.3, (2.0, 1.0, 0.0))
    assert (full.clearcoat, full.clearcoat_roughness) == (0.6, 0.2)


def test_every_texture_slot_with_its_sampler(tmp_path: Path) -> None:
    info = {"index": 0}
    b = textured(
        pbrMetallicRoughness={"baseColorTexture": info, "metallicRoughnessTexture": info},
        normalTexture={"index": 0, "scale": 0.5}, occlusionTexture={"index": 0, "strength": 0.25, "texCoord": 1},
        emissiveTexture=info,
        extensions={
            "KHR_materials_specular": {"specularTexture": info, "specularColorTexture": info},
            "KHR_materials_clearcoat": {"clearcoatTexture": info, "clearcoatRoughnessTexture": info,
                                        "clearcoatNormalTexture": {"index": 0, "scale": 2}},
            "KHR_materials_transmission": {"transmissionTexture": info},
        },
    )  # fmt: skip
    from glhybrid.scene import TEXTURE_SLOTS

    scene = load(b, tmp_path)
    material = scene.materials[0]
    assert set(material.textures) == set(TEXTURE_SLOTS)
    assert (material.normal_scale, material.occlusion_strength, material.clearcoat_normal_scale) == (0.5, 0.25, 2.0)
    assert {slot: t.uv_set for slot, t in material.textures.items()} == {
        s: int(s == "occlusion") for s in TEXTURE_SLOTS
    }
    base = material.textures["base_color"]
    assert (base.wrap_u, base.wrap_v, base.nearest, base.mipmap) == ("clamp", "mirror", True, False)
    assert base.image.name == "dot" and base.image.texels.shape == (1, 1, 4)
    assert base.image is material.textures["occlusion"].image and base is material.textures["emissive"]
    assert any("no TEXCOORD_1" in w for w in scene.warnings)


def test_texture_transform_overrides_the_uv_set(tmp_path: Path) -> None:
    transform = {"offset": [0.1, 0.2], "rotation": np.pi / 2, "scale": [2, 3], "texCoord": 1}
    b = textured(pbrMetallicRoughness={"baseColorTexture": {
        "index": 0, "extensions": {"KHR_texture_transform": transform}}})  # fmt: skip
    b.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_1"] = 2
    texture = load(b, tmp_path).materials[0].textures["base_color"]
    assert texture.uv_set == 1 and texture.uv_transform is not None
    # Scaled, then turned counter-clockwise on the image (u to -v, which is up), then moved.
    np.testing.assert_allclose(texture.uv_transform @ [1, 0, 1], [0.1, 0.2 - 2], atol=1e-12)
    np.testing.assert_allclose(texture.uv_transform @ [0, 1, 1], [0.1 + 3, 0.2], atol=1e-12)


def test_texture_transforms_of_the_khronos_model_hit_their_markers() -> None:
    """Its markers lie where the arrow's tip must appear, so all of them must read the same texel."""
    path = Path(__file__).parents[3] / "shared/models/TextureTransformTest/TextureTransformTest.gltf"
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    scene = load_gltf(path)
    tips = []
    for quad in ("Rotation", "Scale", "All"):
        texture = next(m for m in scene.materials if m.name == quad).textures["base_color"]
        marker = next(n for n in scene.nodes if n.name.startswith(f"{quad} - Correct"))
        uv = np.array([marker.translation[0] + 0.5, 0.5 - marker.translation[1], 1.0])
        assert texture.uv_transform is not None
        tips.append(texture.uv_transform @ uv)
    np.testing.assert_allclose(tips, [[0.778, 0.778]] * 3, atol=0.04)  # the last marker was placed by eye


def test_third_uv_set_is_reported(tmp_path: Path) -> None:
    scene = load(textured(pbrMetallicRoughness={"baseColorTexture": {"index": 0, "texCoord": 2}}), tmp_path)
    assert not scene.materials[0].textures
    assert any("TEXCOORD_2" in w for w in scene.warnings)


def test_normal_map_brings_tangents_given_ones_stay(tmp_path: Path) -> None:
    b = textured(normalTexture={"index": 0})
    made = piece(load(b, tmp_path)).tangent
    np.testing.assert_allclose(made, [[1, 0, 0, 1]] * 4, atol=1e-6)  # upright image: right is +X, up is +Y
    b = textured(normalTexture={"index": 0})
    given = np.float32([[0, 1, 0, -1]] * 4)
    b.json["meshes"][0]["primitives"][0]["attributes"]["TANGENT"] = b.accessor(given)
    np.testing.assert_array_equal(piece(load(b, tmp_path)).tangent, given)
    assert piece(load(textured(), tmp_path)).tangent is None


def test_tangents_follow_the_rotation_of_the_normal_map(tmp_path: Path) -> None:
    turned = {"index": 0, "extensions": {"KHR_texture_transform": {"rotation": np.pi / 2}}}
    tangent = piece(load(textured(normalTexture=turned), tmp_path)).tangent
    assert tangent is not None
    # u' = v: the image's right runs along +v on the surface, which is down.
    np.testing.assert_allclose(tangent, [[0, -1, 0, 1]] * 4, atol=1e-6)


def test_webp_and_optional_basisu(tmp_path: Path) -> None:
    b = textured(pbrMetallicRoughness={"baseColorTexture": {"index": 0}})
    b.json["textures"][0]["extensions"] = {"KHR_texture_basisu": {"source": 1}}
    b.add("images", uri="a.ktx2", mimeType="image/ktx2")
    scene = load(b, tmp_path)
    assert "base_color" in scene.materials[0].textures
    assert scene.warnings == ("KHR_texture_basisu is not supported and ignored in 1 texture",)
    del b.json["textures"][0]["source"]
    with pytest.raises(LoadError, match="KHR_texture_basisu"):
        load(b, tmp_path)


def test_strict_lets_clean_files_pass(tmp_path: Path) -> None:
    assert load(textured(normalTexture={"index": 0}), tmp_path, strict=True).warnings == ()

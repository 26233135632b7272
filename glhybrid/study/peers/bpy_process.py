"""Blender's Cycles on a bundle, in a process of its own: `python -m ... FOLDER ANSWER.npz`."""

import sys
import tempfile
from pathlib import Path

import numpy as np

from glhybrid.study.peers import common

NOTES = [
    "Principled BSDF: its own Fresnel and height-correlated Smith term",
    "8 bounces; lamps are spheres of their radius, spots' edges smooth steps",
]


def main(folder: str, out: str) -> None:
    """Renders what common.read finds in `folder`; common.answer writes `out`."""
    import bpy

    path, about, sky = common.read(folder)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=str(path))
    for material in bpy.data.materials:
        _shine_for_all_rays(material)
        _scatter_once(material)
    scene = bpy.context.scene
    world_from_gltf = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]], float)  # Blender is Z up
    _camera(bpy, scene, about, world_from_gltf)
    for i, light in enumerate(about["lights"]):
        _light(bpy, scene, f"light {i}", light, world_from_gltf)
    with tempfile.TemporaryDirectory(prefix="glhybrid-bpy-") as scratch:
        _sky(bpy, scene, sky)
        scene.render.engine = "CYCLES"
        scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.max_bounces = about["samples"], False, 8
        scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BOX", 0.01
        scene.cycles.use_adaptive_sampling = False
        scene.render.resolution_x, scene.render.resolution_y = about["size"]
        scene.render.resolution_percentage = 100
        scene.view_settings.view_transform = "Raw"
        scene.render.image_settings.file_format = "OPEN_EXR"
        scene.render.image_settings.color_depth = "32"
        scene.render.filepath = str(Path(scratch, "out.exr"))
        _, times = common.timed(lambda: bpy.ops.render.render(write_still=True))
        picture = _read_exr(bpy, scene.render.filepath)
    notes = [f"{about['samples']} paths a pixel", *NOTES]
    common.answer(out, picture, times, bpy.app.version_string, notes)


def _shine_for_all_rays(material) -> None:  # type: ignore[no-untyped-def]
    """What is unlit is imported so that only the camera sees it; mirrors see it as well."""
    nodes = {node.type: node for node in material.node_tree.nodes} if material.use_nodes else {}
    if {"LIGHT_PATH", "EMISSION", "OUTPUT_MATERIAL"} <= nodes.keys():
        shine, out = nodes["EMISSION"].outputs[0], nodes["OUTPUT_MATERIAL"].inputs["Surface"]
        material.node_tree.links.new(shine, out)


def _scatter_once(material) -> None:  # type: ignore[no-untyped-def]
    """glTF's microfacets scatter once; Blender's, unless told so, several times, which makes rough metals brighter."""
    for node in material.node_tree.nodes if material.use_nodes else ():
        if node.type == "BSDF_PRINCIPLED":
            node.distribution = "GGX"


def _camera(bpy, scene, about, world_from_gltf) -> None:  # type: ignore[no-untyped-def]
    from mathutils import Matrix

    data = bpy.data.cameras.new("main")
    data.clip_start, data.clip_end, data.sensor_fit = about["near"], about["extent"] * 100, "VERTICAL"
    if about["fov_y"] > 0:
        data.angle_y = about["fov_y"]
    else:
        data.type, data.ortho_scale = "ORTHO", 2 * about["ymag"]
    camera = bpy.data.objects.new("main", data)
    camera.matrix_world = Matrix((world_from_gltf @ np.array(about["world_from_view"])).tolist())
    scene.collection.objects.link(camera)
    scene.camera = camera


def _light(bpy, scene, name, light, world_from_gltf) -> None:  # type: ignore[no-untyped-def]
    from mathutils import Matrix

    kind = {"directional": "SUN", "point": "POINT", "spot": "SPOT"}[light["kind"]]
    data = bpy.data.lights.new(name, kind)
    data.color = light["color"]
    # Cycles: a sun's strength is irradiance; a lamp of P watts has the radiant intensity P / 4 pi, spots as well.
    data.energy = light["intensity"] * (1.0 if kind == "SUN" else 4 * np.pi)
    if kind == "SUN":
        data.angle = light["angular_diameter"]
    else:
        data.shadow_soft_size = light["radius"]
    if kind == "SPOT":
        data.spot_size = 2 * light["outer_cone"]
        inner, outer = np.cos(light["inner_cone"]), np.cos(light["outer_cone"])
        data.spot_blend = float(np.clip((inner - outer) / max(1 - outer, 1e-6), 0, 1))
    back = -np.array(light["direction"])
    right = np.cross(np.eye(3)[np.argmin(np.abs(back))], back)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = right, np.cross(back, right), back, light["position"]
    lamp = bpy.data.objects.new(name, data)
    lamp.matrix_world = Matrix((world_from_gltf @ pose).tolist())
    scene.collection.objects.link(lamp)


def _sky(bpy, scene, sky) -> None:  # type: ignore[no-untyped-def]
    height, width = sky.shape[:2]
    image = bpy.data.images.new("sky", width, height, float_buffer=True, is_data=True)
    # Blender's equirect has +Y of the world, glTF's -Z, in its middle; its rows start at the bottom.
    texels = np.ones((height, width, 4), np.float32)
    texels[..., :3] = sky[::-1]
    image.pixels.foreach_set(np.roll(texels, -width // 4, 1).ravel())
    world = bpy.data.worlds.new("sky")
    scene.world = world
    world.use_nodes = True
    texture = world.node_tree.nodes.new("ShaderNodeTexEnvironment")
    texture.image = image
    background = world.node_tree.nodes["Background"]
    world.node_tree.links.new(texture.outputs["Color"], background.inputs["Color"])


def _read_exr(bpy, path):  # type: ignore[no-untyped-def]
    image = bpy.data.images.load(path)
    width, height = image.size
    texels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(texels)
    return texels.reshape(height, width, 4)[::-1, :, :3]


if __name__ == "__main__":
    main(*sys.argv[1:])

"""Mitsuba 3's path tracer on a bundle, in a process of its own: `python -m ... FOLDER ANSWER.npz`."""

import sys
from typing import Any

import numpy as np

from glhybrid.study.peers import common
from glhybrid.study.peers.read_glb import Drawn, read

MIRROR = 0.02  # roughness: below, an exact mirror
NOTES = [
    "its principled BSDF: equal for metals, another dielectric (Disney diffuse, true Fresnel)",
    "light between surfaces to 8 bounces; lamps without size, spots' edges linear; mirrors without Fresnel",
]


def main(folder: str, out: str) -> None:
    """Renders what common.read finds in `folder`; common.answer writes `out`."""
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    path, about, sky = common.read(folder)
    width, height = about["size"]
    objects: dict[str, Any] = {"type": "scene", "integrator": {"type": "path", "max_depth": 10}}
    for i, drawn in enumerate(read(path)):
        objects[f"mesh{i}"] = _mesh(mi, f"mesh{i}", drawn)
    for i, light in enumerate(about["lights"]):
        objects[f"light{i}"] = _light(mi, light)
    if sky.any():
        # The first column of its sky, not the middle one, looks along -Z.
        turn = mi.ScalarTransform4f().rotate([0, 1, 0], 180)
        objects["sky"] = {"type": "envmap", "bitmap": mi.Bitmap(_rows_from_pole_to_pole(sky)), "to_world": turn}
    view = np.array(about["world_from_view"])
    view[:3, 0] *= -1  # Mitsuba's cameras look along +Z with +X to the left
    view[:3, 2] *= -1
    sensor: dict[str, Any] = {
        "type": "perspective", "fov": float(np.degrees(about["fov_y"])), "fov_axis": "y", "near_clip": about["near"],
        "far_clip": about["extent"] * 100, "to_world": mi.ScalarTransform4f(view),
        "film": {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}},
        "sampler": {"type": "independent", "sample_count": about["samples"]},
    }  # fmt: skip
    if about["fov_y"] <= 0:
        scale = mi.ScalarTransform4f().scale([about["ymag"] * width / height, about["ymag"] * width / height, 1])
        sensor |= {"type": "orthographic", "to_world": mi.ScalarTransform4f(view) @ scale}
        del sensor["fov"], sensor["fov_axis"]
    objects["sensor"] = sensor
    scene = mi.load_dict(objects)
    picture, times = common.timed(lambda: np.array(mi.render(scene, spp=about["samples"])))
    notes = [f"{about['samples']} paths a pixel, antialiased", *NOTES]
    common.answer(out, picture, times, str(mi.__version__), notes)


def _mesh(mi: Any, name: str, drawn: Drawn) -> Any:
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(_bsdf(mi, drawn))
    if max(drawn.emissive) > 0:
        properties["emitter"] = mi.load_dict({"type": "area", "radiance": {"type": "rgb", "value": drawn.emissive}})
    mesh = mi.Mesh(
        name, len(drawn.position), len(drawn.index), has_vertex_normals=True, has_vertex_texcoords=True,
        props=properties,
    )  # fmt: skip
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = mi.Float(drawn.position.astype(np.float32).ravel())
    parameters["vertex_normals"] = mi.Float(drawn.normal.astype(np.float32).ravel())
    uv = drawn.uv * (1, -1) + (0, 1)  # Mitsuba's v points up
    parameters["vertex_texcoords"] = mi.Float(uv.astype(np.float32).ravel())
    parameters["faces"] = mi.UInt32(drawn.index.astype(np.uint32).ravel())
    parameters.update()
    return mesh


def _bsdf(mi: Any, drawn: Drawn) -> dict[str, Any]:
    if drawn.unlit:  # shines with its colour: the emitter does it
        return {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
    if drawn.metallic >= 1 and drawn.roughness < MIRROR and drawn.roughness_texture is None:
        # Not by principled, which has no exact mirror: it shows lamps without size, as specks all over the picture.
        color: dict[str, Any] = {"type": "rgb", "value": list(drawn.color)}
        if drawn.color_texture is not None:
            color = {"type": "bitmap", "bitmap": mi.Bitmap(drawn.color_texture), "raw": True}
        mirror = {"type": "conductor", "material": "none", "specular_reflectance": color}
        return {"type": "twosided", "bsdf": mirror}
    bsdf: dict[str, Any] = {"type": "principled", "specular": 0.5}
    slots: tuple[tuple[str, Any, Any], ...] = (
        ("base_color", list(drawn.color), drawn.color_texture), ("roughness", drawn.roughness, drawn.roughness_texture),
        ("metallic", drawn.metallic, drawn.metallic_texture),
    )  # fmt: skip
    for key, value, texture in slots:
        if texture is not None:
            bsdf[key] = {"type": "bitmap", "bitmap": mi.Bitmap(texture), "raw": True}
        else:
            bsdf[key] = {"type": "rgb", "value": value} if key == "base_color" else float(value)
    if drawn.normal_texture is not None:
        inner = bsdf
        bsdf = {
            "type": "normalmap", "bsdf": inner,
            "normalmap": {"type": "bitmap", "bitmap": mi.Bitmap(drawn.normal_texture), "raw": True},
        }  # fmt: skip
    bsdf = {"type": "twosided", "bsdf": bsdf}
    if drawn.opacity_texture is not None:
        opacity = {"type": "bitmap", "bitmap": mi.Bitmap(drawn.opacity_texture), "raw": True, "filter_type": "nearest"}
        bsdf = {"type": "mask", "bsdf": bsdf, "opacity": opacity}
    elif drawn.opacity < 1:
        bsdf = {"type": "mask", "bsdf": bsdf, "opacity": float(drawn.opacity)}
    return bsdf


def _light(mi: Any, light: dict[str, Any]) -> dict[str, Any]:
    value = {"type": "rgb", "value": (np.array(light["color"]) * light["intensity"]).tolist()}
    if light["kind"] == "directional":
        return {"type": "directional", "direction": light["direction"], "irradiance": value}
    if light["kind"] == "point":
        return {"type": "point", "position": light["position"], "intensity": value}
    at, way = np.array(light["position"]), np.array(light["direction"])
    up = np.eye(3)[np.argmin(np.abs(way))].tolist()
    pose = mi.ScalarTransform4f().look_at(at.tolist(), (at + way).tolist(), up)
    outer, inner = np.degrees(light["outer_cone"]), np.degrees(light["inner_cone"])
    return {
        "type": "spot", "to_world": pose, "intensity": value, "cutoff_angle": float(outer),
        "beam_width": float(min(inner, outer * 0.999)),
    }  # fmt: skip


def _rows_from_pole_to_pole(sky: Any) -> Any:
    """Mitsuba's rows lie at j / (H - 1) of the way from pole to pole; ours at (j + 0.5) / H."""
    height = len(sky)
    v = np.clip(np.linspace(0, 1, height) * height - 0.5, 0, height - 1)
    j = np.minimum(v.astype(int), height - 2)
    share = (v - j)[:, None, None]
    return np.ascontiguousarray(sky[j] * (1 - share) + sky[j + 1] * share, np.float32)


if __name__ == "__main__":
    main(*sys.argv[1:])

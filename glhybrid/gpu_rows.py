"""Lights and materials as rows of the tables that shaders read (layout.py)."""

import numpy as np

from glhybrid import layout, textures
from glhybrid.scene import F64, SRGB_SLOTS, TEXTURE_SLOTS, Light, Material


def light_rows(lights: tuple[Light, ...], origin: F64) -> np.ndarray:
    """(L,) rows of layout Light, positions relative to origin (3,) float64, world, metres."""
    rows = np.zeros(len(lights), layout.dtype("Light"))
    for row, light in zip(rows, lights, strict=True):
        row["color"] = np.asarray(light.color) * light.intensity
        row["kind"] = layout.CONSTANTS[f"LIGHT_{light.kind.upper()}"]
        row["position"] = np.asarray(light.position) - origin
        row["range"] = light.range
        row["direction"] = light.direction
        # The cone term of KHR_lights_punctual, with its own guard against equal angles.
        scale = 1 / max(0.001, np.cos(light.inner_cone) - np.cos(light.outer_cone))
        row["cone_scale"], row["cone_offset"] = scale, -np.cos(light.outer_cone) * scale
        row["size"] = np.tan(light.angular_diameter / 2) if light.kind == "directional" else light.radius
    return rows


def material_rows(materials: tuple[Material, ...], pages: textures.TexturePages | None) -> np.ndarray:
    """(M,) rows of layout Material, at least one. pages: where their textures lie, if any has one."""
    rows = np.zeros(max(len(materials), 1), layout.dtype("Material"))
    plain = (
        "base_color", "emissive", "metallic", "specular_color", "roughness", "specular", "alpha_cutoff", "normal_scale",
        "occlusion_strength", "clearcoat", "clearcoat_roughness", "clearcoat_normal_scale", "transmission", "unlit",
    )  # fmt: skip
    for row, material in zip(rows, materials, strict=False):
        for name in plain:
            row[name] = getattr(material, name)
        row["dielectric_f0"] = ((material.ior - 1) / (material.ior + 1)) ** 2
        row["alpha_mode"] = layout.CONSTANTS[f"ALPHA_{material.alpha_mode}"]
        row["texture"] = -1
        for k, slot in enumerate(TEXTURE_SLOTS):
            texture = material.textures.get(slot)
            if texture is not None and pages is not None:
                row["texture"][k] = pages.row_of[id(texture), slot in SRGB_SLOTS]
                row["texture_slots"] |= 1 << k
    return rows

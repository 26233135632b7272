"""Scene files and a small model for the tests of them."""

import base64
import json
import struct
from pathlib import Path

from glhybrid.load.scenefile import load_scene_file
from glhybrid.scene import Scene

BOX = '[[object]]\nshape = "box"\n'


def scene(folder: Path, text: str, **options: bool) -> Scene:
    path = folder / "hall.toml"
    path.write_text(text)
    return load_scene_file(path, **options)


def model(path: Path, animated: bool = False) -> Path:
    """A triangle under a node at (0, 0, 1), with a spot light, a camera and perhaps an animation, as one .gltf."""
    data = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0) + struct.pack("<8f", 0, 1, 0, 0, 0, 2, 0, 0)
    gltf: dict[str, object] = {
        "asset": {"version": "2.0"},
        "extensionsUsed": ["KHR_lights_punctual"],
        "extensions": {"KHR_lights_punctual": {"lights": [{"type": "spot", "range": 7, "spot": {}}]}},
        "buffers": [{"byteLength": len(data), "uri": "data:;base64," + base64.b64encode(data).decode()}],
        "bufferViews": [{"buffer": 0, "byteOffset": o, "byteLength": n} for o, n in ((0, 36), (36, 8), (44, 24))],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]},
            {"bufferView": 1, "componentType": 5126, "count": 2, "type": "SCALAR", "min": [0], "max": [1]},
            {"bufferView": 2, "componentType": 5126, "count": 2, "type": "VEC3"},
        ],
        "materials": [{"name": "own", "pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1]}}],
        "meshes": [{"name": "tri", "primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 0.5, "znear": 0.1}}],
        "nodes": [
            {"name": "part", "mesh": 0, "translation": [0, 0, 1]},
            {"name": "lamp", "translation": [0, 2, 0], "extensions": {"KHR_lights_punctual": {"light": 0}}},
            {"name": "view", "camera": 0, "translation": [0, 0, 5]},
        ],
        "scenes": [{"nodes": [0, 1, 2]}],
    }
    if animated:
        gltf["animations"] = [
            {
                "name": "move",
                "samplers": [{"input": 1, "output": 2}],
                "channels": [{"sampler": 0, "target": {"node": 0, "path": "translation"}}],
            }
        ]
    path.write_text(json.dumps(gltf))
    return path


STUDY = """
[study]
title = "acne"
why = "texels"
measure = "wrong shadow"
size = [64, 48]
set = { reflections = "none" }
[[study.fails]]
set = { shadows = "map", "shadows.map.slope_bias" = 0 }
expected = [30, 50]
because = "half"
[[study.holds]]
set = { shadows = "ray" }
expected = [0, 0.01]
"""

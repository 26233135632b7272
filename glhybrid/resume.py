"""Which frames of an interrupted sequence are finished: those whose file carries the fingerprint they would get now.

A fingerprint is over the scene's contents, the settings, the frame's time, size and camera, the layers and our version:
whatever a picture depends on but the device, whose rounding alone differs. It lies in the file itself (PNG text, EXR
attribute, NPZ comment), so it cannot be parted from the picture. Rejected: a list beside the frames, which tells
nothing of files that were moved, mixed or made anew since; times of files, which copies lose.
"""

import dataclasses
import hashlib
import json
import os
import re
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from glhybrid import __version__
from glhybrid.scene import Camera, Scene

KEY = "Fingerprint"
_NOT_SEEN = {"path", "sha256", "warnings", "study"}  # of a Scene: says where it is from, not what it is


def scene_digest(scene: Scene) -> bytes:
    """32 bytes over everything in a scene that can be drawn: arrays, numbers and names, in order."""
    digest = hashlib.blake2b(digest_size=32)
    known: dict[int, int] = {}  # of arrays and images met before: textures are shared

    def add(value: Any) -> None:
        if isinstance(value, np.ndarray):
            if _met(value):
                return
            digest.update(f"{value.dtype.str}{value.shape}".encode())
            digest.update(np.ascontiguousarray(value).data)
        elif dataclasses.is_dataclass(value):
            if _met(value):
                return
            digest.update(type(value).__name__.encode())
            for field in dataclasses.fields(value):
                if not (isinstance(value, Scene) and field.name in _NOT_SEEN):
                    add(getattr(value, field.name))
        elif isinstance(value, (tuple, list)):
            digest.update(b"(%d" % len(value))
            for item in value:
                add(item)
        elif isinstance(value, Mapping):
            digest.update(b"{%d" % len(value))
            for key in sorted(value):
                add(key)
                add(value[key])
        else:
            digest.update(repr(value).encode() + b"\0")

    def _met(value: Any) -> bool:
        if id(value) in known:
            digest.update(b"=%d" % known[id(value)])
            return True
        known[id(value)] = len(known)
        return False

    add(scene)
    return digest.digest()


def fingerprint(scene: bytes, settings: Mapping[str, Any], camera: Camera, **more: Any) -> str:
    """64 hexadecimal digits. scene: its digest. more: whatever else the file depends on, ready for JSON."""
    view = {f.name: getattr(camera, f.name) for f in dataclasses.fields(camera)}
    view["world_from_view"] = np.asarray(camera.world_from_view, np.float64).tobytes().hex()
    said = json.dumps([__version__, settings, view, more], sort_keys=True, default=str)
    return hashlib.blake2b(scene + said.encode(), digest_size=32).hexdigest()


def fingerprint_of(path: Path) -> str | None:
    """What a .png, .exr or .npz says of itself; None where it says nothing, is broken or is not there."""
    try:
        if path.suffix.lower() == ".png":
            from PIL import Image

            with Image.open(path) as picture:
                said = picture.info.get(KEY)
        elif path.suffix.lower() == ".exr":
            import OpenEXR

            if not path.is_file():
                return None
            with OpenEXR.File(str(path), header_only=True) as file:
                said = file.header().get(KEY.lower())
        else:
            with zipfile.ZipFile(path) as archive:
                said = archive.comment.decode("ascii", "replace").removeprefix(f"{KEY}: ")
    except (OSError, ValueError, RuntimeError, SyntaxError, zipfile.BadZipFile):
        return None
    return said if isinstance(said, str) and said else None


def remove_leftovers(path: Path) -> None:
    """Half-written files of this name whose process was killed."""
    for part in _parts(path):
        pid = int(part.name.split(".")[-3])
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            part.unlink(missing_ok=True)
        except PermissionError:
            pass  # somebody else's, and alive


def _parts(path: Path) -> Iterator[Path]:
    name = re.compile(re.escape(f".{path.stem}.") + r"\d+\.part" + re.escape(path.suffix))
    return (p for p in path.parent.iterdir() if name.fullmatch(p.name))

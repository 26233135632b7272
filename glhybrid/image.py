"""What a render gives back, and how it is written: PNG to look at, EXR and NPZ to compute with.

`AOVS` is the one table of outputs: dtype, channels, unit, space and the value where the camera ray meets nothing. The
renderer fills arrays by it, EXR layer names come from it, and a test holds every row against a rendered frame.
Files are written beside their final name and moved there when complete, so a failure leaves nothing half-written.
"""

import contextlib
import io
import json
import logging
import os
import sys
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from glhybrid import __version__
from glhybrid.errors import OutputError, SettingError, unknown

log = logging.getLogger("glhybrid")

Array = NDArray[Any]
SUFFIXES = (".png", ".exr", ".npz")
MOVIE_SUFFIXES = (".mp4", ".webp", ".gif", ".apng")  # of sequences
HALF_MAX = 65504.0
LONGEST_NAME = 230  # bytes: file systems take 255, a temporary name has a few more
NO_ID = 0xFFFFFFFF


@dataclass(frozen=True)
class Aov:
    """One output. channels: EXR's part names; with more than one they are the array's last axis; () = one per light.

    miss: the value where the camera ray meets nothing; None = what the environment shows there.
    """

    dtype: Literal["float32", "uint32", "uint8"]
    channels: tuple[str, ...]
    unit: str
    space: str
    miss: float | None
    meaning: str

    def shape(self, height: int, width: int, lights: int = 0) -> tuple[int, ...]:
        """Of its array, for pictures of that size and a scene of so many lights."""
        if not self.channels:
            return height, width, lights
        return (height, width) if len(self.channels) == 1 else (height, width, len(self.channels))


_RGB, _XYZ = ("R", "G", "B"), ("X", "Y", "Z")
AOVS: dict[str, Aov] = {
    "radiance": Aov("float32", _RGB, "radiance", "linear Rec. 709", None, "the picture before exposure and tone map"),
    "depth": Aov("float32", ("Z",), "m", "camera", np.inf, "distance along the view axis"),
    "distance": Aov("float32", ("Z",), "m", "camera", np.inf, "distance along the camera ray"),
    "position": Aov("float32", _XYZ, "m", "world", 0, "the surface point"),
    "normal": Aov(
        "float32", _XYZ, "unit vector", "world", 0, "shading normal after the normal map, towards the viewer"
    ),
    "normal_geometric": Aov("float32", _XYZ, "unit vector", "world", 0, "the triangle's normal, towards the viewer"),
    "albedo": Aov("float32", _RGB, "0 to 1", "linear Rec. 709", 0, "base colour"),
    "roughness": Aov("float32", ("Y",), "0 to 1", "", 0, "perceptual roughness"),
    "metallic": Aov("float32", ("Y",), "0 to 1", "", 0, "metallic"),
    "emissive": Aov("float32", _RGB, "radiance", "linear Rec. 709", 0, "light the surface gives off"),
    "instance_id": Aov("uint32", ("id",), "index", "", NO_ID, "index into Scene.instances"),
    "material_id": Aov("uint32", ("id",), "index", "", NO_ID, "index into Scene.materials"),
    "triangle_id": Aov("uint32", ("id",), "index", "", NO_ID, "triangle within its mesh"),
    "motion": Aov(
        "float32",
        ("X", "Y"),
        "pixels",
        "image, x right, y down",
        0,
        "to where the point was a frame ago; 0 in a first one",
    ),
    "visibility": Aov("float32", (), "0 to 1", "", 0, "how much of each light arrives"),
    "occlusion": Aov(
        "float32", ("Y",), "0 to 1", "", 1, "open share of the sky, by `ao`; 1 all over where that is off"
    ),
    "reflection": Aov("float32", _RGB, "radiance", "linear Rec. 709", 0, "what the mirror direction shows"),
    "reflection_hit": Aov("float32", ("Z",), "m", "", 0, "length of the mirror ray; +inf: sky; 0: no ray was sent"),
    "reason": Aov("uint8", ("id",), "code", "", 0, "why reflections gave up at this pixel (layout.REASON_*); 0: not"),
    "reason_shadows": Aov("uint8", ("id",), "code", "", 0, "the same of shadows, of the last light that has a reason"),
    "reason_ao": Aov("uint8", ("id",), "code", "", 0, "the same of ambient occlusion"),
    "bvh_steps": Aov("uint32", ("Y",), "count", "", 0, "nodes and triangles tested by its shadow and mirror rays"),
}


def check_aovs(names: Iterable[str]) -> tuple[str, ...]:
    """The names without repeats, in order; "depth,normal" is two. Raises SettingError for an unknown one."""
    wanted = tuple(dict.fromkeys(names.split(",") if isinstance(names, str) else names))
    for name in wanted:
        if name not in AOVS:
            raise SettingError(unknown("AOV", name, AOVS))
    return wanted


@dataclass(eq=False, repr=False)
class Frame:
    """One rendered picture: `rgb` (H, W, 3) uint8 as displayed (sRGB), AOVs by name, and the receipt.

    `frame["depth"]` is the array of that AOV as `AOVS` describes it; row 0 is the top. The receipt, ready for JSON,
    says what was drawn, on what, by which passes and for how long: `scene`, `device`, `settings`, `camera` (its place,
    K in pixels), `plan`, `bvh`, `passes` ([{name, ms}]), `frame_ms`, `first_image_ms`.
    """

    rgb: NDArray[np.uint8]
    arrays: dict[str, Array] = field(default_factory=dict)
    receipt: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        assert self.rgb.ndim == 3 and self.rgb.shape[2] == 3 and self.rgb.dtype == np.uint8, self.rgb.shape
        height, width = self.rgb.shape[:2]
        for name, array in self.arrays.items():
            lights = array.shape[-1] if not AOVS[name].channels else 0
            want = AOVS[name].shape(height, width, lights)
            assert array.shape == want and array.dtype == AOVS[name].dtype, (name, array.shape, array.dtype, want)

    @property
    def size(self) -> tuple[int, int]:
        """(W, H) in pixels."""
        return self.rgb.shape[1], self.rgb.shape[0]

    def __repr__(self) -> str:
        """Short, for sessions; notebooks show the picture."""
        scene = self.receipt.get("scene", {}).get("name", "")
        return f"<Frame {self.size[0]}x{self.size[1]} of {scene or 'a scene'}: {', '.join(('rgb', *self.arrays))}>"

    def __getitem__(self, name: str) -> Array:
        """An AOV's array, shape and dtype as `AOVS` says. Raises SettingError for one that was not asked for."""
        check_aovs([name])
        if name not in self.arrays:
            have = ", ".join(self.arrays) or "none"
            raise SettingError(f'this frame has no "{name}": render it with aovs=("{name}",); it has: {have}')
        return self.arrays[name]

    def save(self, path: str | Path, aov: Iterable[str] | None = None, exr_float: bool = False) -> list[str]:
        """Writes .png, .exr or .npz by suffix; `-` is PNG to standard output. aov: which AOVs; None = all.

        Returns what was lost in writing, one sentence each; it is logged and added to the receipt's `warnings` too.
        Raises OutputError where it cannot be written, SettingError for an AOV that the frame or the format lacks.
        """
        suffix = check_output(path, tuple(aov or ()), folder=False)
        names = check_aovs(aov if aov is not None else self.arrays)
        arrays = {name: self[name] for name in names}
        warnings: list[str] = []
        if suffix == ".png":
            data = encode_png(self.rgb, self.receipt)
            if str(path) == "-":
                sys.stdout.buffer.write(data)
                sys.stdout.buffer.flush()
            else:
                with replacing(Path(path)) as temporary:
                    temporary.write_bytes(data)
        elif suffix == ".exr":
            arrays.pop("radiance", None)
            channels, warnings = exr_channels(self["radiance"], arrays, exr_float)
            with replacing(Path(path)) as temporary:
                _write_exr(temporary, channels, self.receipt)
        else:
            with replacing(Path(path)) as temporary, temporary.open("w+b") as file:
                np.savez(file, **{"radiance": self["radiance"], **arrays}, allow_pickle=False)
                if "fingerprint" in self.receipt:
                    with zipfile.ZipFile(file, "a") as archive:
                        archive.comment = f"Fingerprint: {self.receipt['fingerprint']}".encode()
        for warning in warnings:
            log.warning("%s: %s", path, warning)
            self.receipt.setdefault("warnings", []).append(warning)
        return warnings

    def _repr_png_(self) -> bytes:
        return encode_png(self.rgb, self.receipt)


def check_output(path: str | Path, aov: tuple[str, ...] = (), folder: bool = True) -> str:
    """The output's suffix, before any work is spent on it. folder: also that the folder can be written to.

    Raises OutputError for a suffix we do not write and for a place that cannot be written, SettingError for AOVs that
    the format cannot hold.
    """
    check_aovs(aov)
    if str(path) == "-":
        suffix = ".png"
        if folder and sys.stdout.isatty():
            raise OutputError("-: standard output is a terminal: send it to a file or a pipe, or give a name")
    else:
        suffix = Path(path).suffix.lower()
        if suffix in MOVIE_SUFFIXES:
            raise OutputError(f"{path}: a movie is made of --frames, --turntable or --path: give one of them")
        if suffix not in SUFFIXES:
            raise OutputError(f'{path}: cannot write "{suffix or "no suffix"}"; supported: {", ".join(SUFFIXES)} and -')
        if folder:
            check_folder(Path(path))
    if suffix == ".png" and aov:
        raise SettingError(f"{path}: PNG holds no AOVs ({', '.join(aov)}): write .exr or .npz")
    return suffix


def check_folder(path: Path) -> None:
    """Raises OutputError where a file cannot be put."""
    folder = path.parent
    if "\0" in str(path) or len(os.fsencode(path.name)) > LONGEST_NAME:
        raise OutputError(f"{str(path)[:80]!r}: not a file name: at most {LONGEST_NAME} bytes, none of them 0")
    if not folder.exists():
        raise OutputError(f"{path}: there is no folder {folder}: mkdir -p {folder}")
    if not folder.is_dir():
        raise OutputError(f"{path}: {folder} is not a folder")
    if path.is_dir():
        raise OutputError(f"{path}: is a folder: give a file name, such as {path / 'out.png'}")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise OutputError(f"{path}: the folder {folder} cannot be written to: choose another with -o")


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary name in the same folder that becomes `path` if the block succeeds and vanishes if it does not."""
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    except (OSError, RuntimeError) as error:  # RuntimeError is OpenEXR's word for every failure, a full disk included
        raise OutputError(f"{path}: cannot be written: {getattr(error, 'strerror', None) or error}") from None
    finally:
        temporary.unlink(missing_ok=True)


def encode_png(rgb: NDArray[np.uint8], receipt: Mapping[str, Any]) -> bytes:
    """PNG bytes, tagged as sRGB, with the settings in its text."""
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    info = PngInfo()
    info.add(b"sRGB", b"\x00")  # rendering intent: perceptual
    for key, text in metadata(receipt).items():
        info.add_text(key, text)
    buffer = io.BytesIO()
    Image.fromarray(rgb).save(buffer, "PNG", pnginfo=info, compress_level=4)  # 6, the default: twice the time, 2 % less
    return buffer.getvalue()


def exr_channels(
    radiance: Array, arrays: Mapping[str, Array], exr_float: bool = False
) -> tuple[dict[str, Array], list[str]]:
    """EXR channels by name, and what does not survive: radiance past half's range is cut to it, with a sentence."""
    warnings: list[str] = []
    if not exr_float:
        large = int((radiance > HALF_MAX).any(-1).sum())
        if large:
            largest = f"the largest is {float(radiance.max()):g}"
            warnings.append(
                f"{large} pixels past half's range of {HALF_MAX:g} were cut to it ({largest}): use --exr-float"
            )
        radiance = np.clip(radiance, -HALF_MAX, HALF_MAX).astype(np.float16)
    channels = {part: np.ascontiguousarray(radiance[..., i]) for i, part in enumerate(_RGB)}
    for name, array in arrays.items():
        planes = array[..., None] if array.ndim == 2 else array
        parts = AOVS[name].channels or tuple(str(i) for i in range(planes.shape[2]))
        kind = np.float32 if AOVS[name].dtype == "float32" else np.uint32  # EXR has no 8-bit integers
        for i, part in enumerate(parts):
            channels[f"{name}.{part}"] = np.ascontiguousarray(planes[..., i], kind)
    return channels, warnings


def _write_exr(path: Path, channels: dict[str, Array], receipt: Mapping[str, Any]) -> None:
    import OpenEXR

    header: dict[str, Any] = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    header |= {key.lower(): text for key, text in metadata(receipt).items()}
    OpenEXR.File(header, channels).write(str(path))


def metadata(receipt: Mapping[str, Any]) -> dict[str, str]:
    """What a picture says of itself, by name."""
    texts = {"Software": f"glhybrid {__version__}"}
    if "settings" in receipt:
        texts["Settings"] = json.dumps(receipt["settings"])
    if "fingerprint" in receipt:
        texts["Fingerprint"] = str(receipt["fingerprint"])
    scene = receipt.get("scene")
    if isinstance(scene, Mapping) and scene.get("sha256"):
        texts["Scene"] = str(scene["sha256"])
    return texts

"""Wavefront MTL materials to metallic-roughness ones.

The format predates physically based shading; the mapping is the usual one. Kd, Ke and map_Kd keep their meaning,
numbers are linear. Ns is a Blinn-Phong exponent: alpha = sqrt(2 / (Ns + 2)) (Walter et al. 2007), roughness its root.
Ks says only whether there is a highlight at all, whose strength follows from ior. Pr and Pm (the PBR extension) win.
"""

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from glhybrid.errors import LoadError
from glhybrid.load.images import load_image
from glhybrid.load.report import Report
from glhybrid.scene import Image, Material, Texture

MAPS = {"map_kd": "base_color", "map_ke": "emissive", "norm": "normal", "map_bump": "bump", "bump": "bump",
        "map_d": "alpha", "map_pr": "roughness", "map_pm": "metallic"}  # fmt: skip
UNUSED_MAPS = frozenset({"map_ka", "map_ks", "map_ns", "map_tr", "map_ps", "refl", "disp", "decal", "map_ao"})
MEANINGLESS = frozenset({"ka", "illum", "tf", "sharpness", "aniso", "anisor", "ps", "pc", "pcr"})
OPTION_LENGTHS = {"-blendu": 1, "-blendv": 1, "-boost": 1, "-cc": 1, "-clamp": 1, "-imfchan": 1, "-texres": 1,
                  "-type": 1, "-bm": 1, "-mm": 2, "-o": 3, "-s": 3, "-t": 3}  # fmt: skip
CUT_OUT_SHARE = 0.9  # of the texels of map_d that must be nearly 0 or 1 for a cut-out; else it is see-through


@dataclass
class _Statements:
    """One newmtl block: numbers by keyword, map lines by slot."""

    name: str
    numbers: dict[str, list[float]] = field(default_factory=dict)
    maps: dict[str, tuple[Path, dict[str, list[str]]]] = field(default_factory=dict)


def read_mtl(path: Path, text: str, report: Report, files: "Files") -> dict[str, Material]:
    """Materials by name. files: reads and remembers images. Raises LoadError naming line, value and what was wanted."""
    blocks: list[_Statements] = []
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split("#")[0].split() if not line.lstrip().startswith("#") else []
        if not words:
            continue
        keyword = words[0].lower()
        if keyword == "newmtl":
            blocks.append(_Statements(line.split(None, 1)[1].strip() if len(words) > 1 else ""))
        elif not blocks:
            raise LoadError(f'{path}: line {number}: "{words[0]}" before the first newmtl: not an MTL file')
        elif keyword in MAPS:
            blocks[-1].maps[MAPS[keyword]] = _map_line(path, number, line)
        elif keyword in UNUSED_MAPS:
            report.warn(f"{words[0]} is not used", f'material "{blocks[-1].name}"')
        elif keyword not in MEANINGLESS:
            blocks[-1].numbers[keyword] = _numbers(path, number, words)
    return {b.name: _material(b, path, report, files) for b in blocks}


def _numbers(path: Path, number: int, words: list[str]) -> list[float]:
    if len(words) > 1 and words[1] in ("spectral", "xyz"):
        raise LoadError(f"{path}: line {number}: {words[1]} colours are not read; write three numbers")
    try:
        values = [float(w) for w in words[1:] if w != "-halo"]
    except ValueError:
        raise LoadError(f'{path}: line {number}: "{" ".join(words)}" must hold numbers') from None
    if not values or not np.isfinite(values).all():
        raise LoadError(f'{path}: line {number}: "{" ".join(words)}" must hold finite numbers')
    return values


def _map_line(path: Path, number: int, line: str) -> tuple[Path, dict[str, list[str]]]:
    """The file and the options of a map statement. The file name is the rest of the line: it may hold blanks."""
    rest = line.split(None, 1)[1].strip() if len(line.split()) > 1 else ""
    options: dict[str, list[str]] = {}
    while rest.startswith("-"):
        option, _, rest = rest.partition(" ")
        rest = rest.strip()
        values: list[str] = []
        for _ in range(OPTION_LENGTHS.get(option.lower(), 1)):
            word, _, after = rest.partition(" ")
            if values and not is_number(word):  # -o, -s and -t take one to three numbers
                break
            values.append(word)
            rest = after.strip()
        options[option.lower()] = values
    if not rest:
        raise LoadError(f"{path}: line {number}: names no image file")
    return Path(rest.replace("\\", "/")), options


def is_number(word: str) -> bool:
    """Whether Python reads it as a float."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def _material(block: _Statements, path: Path, report: Report, files: "Files") -> Material:
    label = f'material "{block.name}"'

    def color(key: str, default: tuple[float, float, float]) -> tuple[float, float, float]:
        v = [max(x, 0.0) for x in block.numbers.get(key, default)]
        return (v[0], v[1], v[2]) if len(v) >= 3 else (v[0], v[0], v[0])

    def one(key: str, default: float) -> float:
        return block.numbers.get(key, [default])[0]

    def image(slot: str) -> Image | None:
        return files.image(path.parent, block.maps[slot][0], f"{path}: {label}") if slot in block.maps else None

    fields: dict[str, Any] = {"name": block.name, "emissive": color("ke", (0.0, 0.0, 0.0))}
    textures: dict[str, Texture] = {}

    def put(slot: str, source: str, picture: Image) -> None:
        textures[slot] = _texture(picture, block.maps[source][1])

    kd = tuple(min(c, 1.0) for c in color("kd", (1.0, 1.0, 1.0)))
    if "base_color" in block.maps and max(kd) == 0.0:
        report.warn("its Kd is black and would hide its map_Kd: white was used", label)
        kd = (1.0, 1.0, 1.0)
    alpha = min(max(one("d", 1.0 - one("tr", 0.0)), 0.0), 1.0)
    fields["base_color"] = (*kd, alpha)
    if alpha < 1.0:
        fields["alpha_mode"] = "BLEND"
    base, cut = image("base_color"), image("alpha")
    if cut is not None:
        base = _with_alpha(base, cut)
        opacity = base.texels[..., 3]
        clear_cut = np.mean((opacity < 26) | (opacity > 229)) >= CUT_OUT_SHARE
        fields["alpha_mode"] = "MASK" if clear_cut and alpha == 1.0 else "BLEND"
    if base is not None:
        put("base_color", "base_color" if "base_color" in block.maps else "alpha", base)
    if (emissive := image("emissive")) is not None:
        put("emissive", "emissive", emissive)
        if "ke" not in block.numbers:
            fields["emissive"] = (1.0, 1.0, 1.0)
    _put_normal_map(block, image, put, fields, report, label)
    fields["metallic"] = min(max(one("pm", 0.0), 0.0), 1.0)
    fields["roughness"] = min(max(one("pr", (2.0 / (max(one("ns", 0.0), 0.0) + 2.0)) ** 0.25), 0.0), 1.0)
    _put_roughness_map(block, image, put, fields)
    if one("ni", 0.0) > 1.0:
        fields["ior"] = one("ni", 1.5)
    if "ks" in block.numbers and max(color("ks", (0.0, 0.0, 0.0))) == 0.0:
        fields["specular"] = 0.0
        if "pr" not in block.numbers:
            fields["roughness"] = 1.0
    return Material(**fields, textures=textures)


def _texture(image: Image, options: dict[str, list[str]]) -> Texture:
    scale = [float(v) if is_number(v) else 1.0 for v in options.get("-s", [])] + [1.0] * 2
    offset = [float(v) if is_number(v) else 0.0 for v in options.get("-o", [])] + [0.0] * 2
    transform = None
    if scale[:2] != [1.0, 1.0] or offset[:2] != [0.0, 0.0]:
        # MTL scales and moves with v up: 1 - (s (1 - v) + o) = s v + (1 - s - o).
        transform = np.array([[scale[0], 0.0, offset[0]], [0.0, scale[1], 1.0 - scale[1] - offset[1]]])
    wrap = "clamp" if options.get("-clamp", ["off"])[0].lower() == "on" else "repeat"
    return Texture(image, uv_transform=transform, wrap_u=wrap, wrap_v=wrap)  # type: ignore[arg-type]


def _put_normal_map(
    block: _Statements, image: Any, put: Any, fields: dict[str, Any], report: Report, label: str
) -> None:
    """norm is a normal map; bump a height map by the book and a normal map in many files, told apart by its colour."""
    if (picture := image("normal")) is not None:
        put("normal", "normal", picture)
    elif (picture := image("bump")) is not None:
        mean = picture.texels[..., :3].reshape(-1, 3).mean(axis=0)
        if mean[2] > 150 and mean[2] > mean[0] + 30 and mean[2] > mean[1] + 30:
            put("normal", "bump", picture)
            strength = block.maps["bump"][1].get("-bm", ["1"])[0]
            fields["normal_scale"] = float(strength) if is_number(strength) else 1.0
        else:
            report.warn("its bump map is a height map and not drawn: make it a normal map (norm)", label)


def _put_roughness_map(block: _Statements, image: Any, put: Any, fields: dict[str, Any]) -> None:
    """map_Pr and map_Pm to one glTF texture: roughness in green, metallic in blue."""
    rough, metal = image("roughness"), image("metallic")
    if rough is None and metal is None:
        return
    size = (rough or metal).texels.shape[:2]
    packed = np.full((*size, 4), 255, np.uint8)
    for picture, channel, key in ((rough, 1, "roughness"), (metal, 2, "metallic")):
        if picture is not None:
            packed[..., channel] = _resized(picture, size)[..., 0]
            fields[key] = 1.0
    put("metallic_roughness", "roughness" if rough is not None else "metallic", Image(packed, (rough or metal).name))


def _with_alpha(base: Image | None, cut: Image) -> Image:
    """base with the grey of cut as its alpha."""
    if base is None:
        texels = np.full((*cut.texels.shape[:2], 4), 255, np.uint8)
    else:
        texels = base.texels.copy()
    source = _resized(cut, texels.shape[:2])
    # A file with an alpha channel of its own holds the opacity there.
    texels[..., 3] = source[..., 3] if source[..., 3].min() < 255 else source[..., 0]
    return Image(texels, base.name if base is not None else cut.name)


def _resized(image: Image, size: tuple[int, ...]) -> Any:
    if image.texels.shape[:2] == size:
        return image.texels
    from PIL import Image as Pillow

    return np.asarray(Pillow.fromarray(image.texels).resize((size[1], size[0]), Pillow.Resampling.BILINEAR))


class Files:
    """Files that a model names: read once, hashed in the order they are read, kept inside the model's folder."""

    def __init__(self, model: Path, report: Report, hasher: Any, allow_outside: bool) -> None:
        self.model, self.report, self.hash, self.allow_outside = model, report, hasher, allow_outside
        self._images: dict[Path, Image] = {}

    def read(self, folder: Path, name: Path, owner: str) -> bytes | None:
        """The bytes; None where there is no such file. Raises LoadError where it lies outside or cannot be read."""
        path = folder / name
        self._check_inside(path, name, owner)
        if not path.is_file():
            return None
        try:
            data = path.read_bytes()
        except (OSError, ValueError) as error:
            raise LoadError(f"{owner}: {path} cannot be read: {error}") from None
        self.hash.update(data)
        return data

    def image(self, folder: Path, name: Path, owner: str) -> Image:
        """An image beside the file, read once. owner: who names it, for messages. Raises LoadError."""
        path = folder / name
        if path not in self._images:
            data = self.read(folder, name, owner)
            if data is None:
                raise LoadError(f"{owner}: there is no file {path}; put it there or remove the map from the material")
            image = load_image(data, f"{owner} ({name})", lambda lost: self.report.warn(lost, str(name)))
            self._images[path] = Image(image.texels, name.name)
        return self._images[path]

    def _check_inside(self, path: Path, name: Path, owner: str) -> None:
        inside = (
            os.path.relpath(os.path.normpath(path), os.path.normpath(self.model.parent)).split(os.sep)[0] != os.pardir
        )
        if not inside and not self.allow_outside:
            raise LoadError(f'{owner}: "{name}" leaves the folder of the model; allow outside files if you trust it')

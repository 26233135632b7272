"""The container of a glTF 2.0 asset: JSON or GLB, its files, and checked access to its JSON objects.

Whatever a file holds, reading it through `Item` gives a value of the wanted type and range or one LoadError that names
the object. So the modules that give the values their meaning need no checks for shape of their own.
"""

import base64
import binascii
import hashlib
import json
import math
import os
import re
import struct
import urllib.parse
from pathlib import Path
from typing import Any

from glhybrid.errors import LoadError
from glhybrid.load.report import Report

KINDS = {  # the arrays at the top of a glTF file, and what one of their elements is called
    "accessors": "accessor",
    "animations": "animation",
    "buffers": "buffer",
    "bufferViews": "bufferView",
    "cameras": "camera",
    "images": "image",
    "materials": "material",
    "meshes": "mesh",
    "nodes": "node",
    "samplers": "sampler",
    "scenes": "scene",
    "skins": "skin",
    "textures": "texture",
}
REFERENCES = (  # (kind, key, kind referred to) of each plain reference between those arrays
    ("accessors", "bufferView", "bufferViews"),
    ("bufferViews", "buffer", "buffers"),
    ("images", "bufferView", "bufferViews"),
    ("nodes", "camera", "cameras"),
    ("nodes", "mesh", "meshes"),
    ("nodes", "skin", "skins"),
    ("skins", "inverseBindMatrices", "accessors"),
    ("skins", "skeleton", "nodes"),
    ("textures", "sampler", "samplers"),
    ("textures", "source", "images"),
)
_REQUIRED: Any = object()
_JSON_CHUNK, _BIN_CHUNK = 0x4E4F534A, 0x004E4942


class Item:
    """One JSON object of the file: its data, and the label messages call it by."""

    __slots__ = ("data", "doc", "label")

    def __init__(self, doc: "Document", label: str, data: Any) -> None:
        self.doc, self.label = doc, label
        if not isinstance(data, dict):
            raise self.fail(f"is {show(data)}, must be a JSON object")
        self.data: dict[str, Any] = data

    def fail(self, problem: str) -> LoadError:
        """The error to raise: file, item, problem."""
        return LoadError(f"{self.doc.path}: {self.label}: {problem}" if self.label else f"{self.doc.path}: {problem}")

    def warn(self, remark: str) -> None:
        """Says what was dropped or changed of this item; with `strict` that raises LoadError."""
        self.doc.report.warn(remark, self.label)

    def _get(self, key: str, default: Any) -> Any:
        value = self.data.get(key, default)
        if value is _REQUIRED:
            raise self.fail(f'"{key}" is missing')
        return value

    def integer(self, key: str, default: Any = _REQUIRED, low: int = 0, high: int | None = None) -> Any:
        """An integer in low..high; the default as it stands where the key is absent."""
        if key not in self.data and default is not _REQUIRED:
            return default
        value = self._get(key, default)
        if isinstance(value, float) and value.is_integer():  # JSON has one number type: 3.0 is an integer
            value = int(value)
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.fail(f'"{key}" is {show(value)}, must be an integer')
        if value < low or (high is not None and value > high):
            raise self.fail(
                f'"{key}" is {show(value)}, must be {f"{low} to {high}" if high is not None else f">= {low}"}'
            )
        return value

    def number(self, key: str, default: Any = _REQUIRED) -> Any:
        """A finite number; the default as it stands where the key is absent."""
        if key not in self.data and default is not _REQUIRED:
            return default
        return self._finite(key, self._get(key, default))

    def numbers(self, key: str, count: int | None, default: Any = _REQUIRED) -> Any:
        """A tuple of `count` finite numbers (any, if None); the default as it stands where the key is absent."""
        if key not in self.data and default is not _REQUIRED:
            return default
        value = self._get(key, default)
        if not isinstance(value, list) or (count is not None and len(value) != count):
            raise self.fail(f'"{key}" is {show(value)}, must be {count if count is not None else "a list of"} numbers')
        return tuple(self._finite(key, v) for v in value)

    def _finite(self, key: str, value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.fail(f'"{key}" holds {show(value)}, must be a number')
        try:
            value = float(value)
        except OverflowError:
            value = math.inf
        if not math.isfinite(value):
            raise self.fail(f'"{key}" holds {value}, must be finite')
        return value

    def string(self, key: str, default: Any = _REQUIRED) -> Any:
        """A text. Raises LoadError if it is another type, or missing without a default."""
        value = self._get(key, default)
        if key in self.data and not isinstance(value, str):
            raise self.fail(f'"{key}" is {show(value)}, must be a string')
        return value

    def boolean(self, key: str, default: bool = False) -> bool:
        """true or false. Raises LoadError for anything else."""
        value = self._get(key, default)
        if not isinstance(value, bool):
            raise self.fail(f'"{key}" is {show(value)}, must be true or false')
        return value

    def choice(self, key: str, default: Any, known: dict[Any, Any]) -> Any:
        """The value that `known` gives for the one in the file."""
        value = self._get(key, default)
        if isinstance(value, list | dict) or value not in known:
            raise self.fail(f'"{key}" is {show(value)}, must be one of {", ".join(str(k) for k in known)}')
        return known[value]

    def child(self, key: str, label: str = "") -> "Item | None":
        """The object under a key, or None."""
        if key not in self.data:
            return None
        return Item(self.doc, self._join(label or key), self.data[key])

    def children(self, key: str, singular: str) -> "list[Item]":
        """The objects in the list under a key, labelled by singular and number; none where the key is absent."""
        value = self._get(key, [])
        if not isinstance(value, list):
            raise self.fail(f'"{key}" is {show(value)}, must be a list')
        return [Item(self.doc, self._join(f"{singular} {i}"), data) for i, data in enumerate(value)]

    def _join(self, label: str) -> str:
        return f"{self.label}, {label}" if self.label else label

    def extension(self, name: str) -> "Item | None":
        """The item's extension of that name; None if it has none."""
        extensions = self.child("extensions")
        return (
            Item(self.doc, self._join(name), extensions.data[name]) if extensions and name in extensions.data else None
        )

    def index(self, key: str, kind: str, default: Any = None) -> Any:
        """A number that refers to an element of a top-level array; the default where the key is absent."""
        if key not in self.data and default is not _REQUIRED:
            return default
        return self._refer(key, self.integer(key), kind)

    def required_index(self, key: str, kind: str) -> int:
        """The index of an item of a kind, in range. Raises LoadError if it is missing or none."""
        return int(self.index(key, kind, _REQUIRED))

    def indices(self, key: str, kind: str) -> tuple[int, ...]:
        """Numbers that refer to elements of a top-level array; none where the key is absent."""
        value = self._get(key, [])
        if not isinstance(value, list):
            raise self.fail(f'"{key}" is {show(value)}, must be a list')
        whole = [Item(self.doc, self.label, {key: v}).integer(key) for v in value]
        return tuple(self._refer(key, i, kind) for i in whole)

    def _refer(self, key: str, i: int, kind: str) -> int:
        count = self.doc.count(kind)
        if i >= count:
            has = f"{count} (0 to {count - 1})" if count else "none"
            raise self.fail(f'"{key}" refers to {KINDS[kind]} {show(i)}, the file has {has}')
        return i

    @property
    def name(self) -> str:
        """As the file has it, fit to be printed; may be empty."""
        return printable(self.string("name", ""))


def show(value: Any) -> str:
    """A value from the file for a message, kept short."""
    try:
        text = printable(json.dumps(value, ensure_ascii=False))
    except ValueError:  # an integer of more digits than Python will print
        text = "a number of thousands of digits"
    return text if len(text) <= 60 else text[:57] + "..."


def printable(text: str) -> str:
    """The text with lone surrogates, which JSON can hold and no output can, as question marks."""
    return text.encode("utf-8", "replace").decode()


class Document:
    """A glTF asset in memory. `items` gives its objects, `buffer` and `read_uri` its bytes."""

    def __init__(self, path: Path, report: Report, allow_outside: bool = False) -> None:
        """Raises LoadError where the file is absent, is no glTF 2, is cut short, or names a buffer that is."""
        self.path, self.report, self.allow_outside = path, report, allow_outside
        data = _read_file(path, str(path))
        self.hash = hashlib.sha256(data)
        self._fetched: dict[str, bytes] = {}
        self._binary: memoryview | None = None
        text: bytes | memoryview = data
        if data[:4] == b"glTF":
            text, self._binary = self._split_glb(data)
        elif path.suffix.lower() == ".glb" and data.lstrip()[:1] != b"{":  # JSON under that name is read all the same
            raise self.fail(f'starts with {data[:4]!r}, a GLB with "glTF": not a model, or cut short')
        self.root = Item(self, "", self._parse(bytes(text)))
        self._items: dict[str, list[Item]] = {}
        self._check_version()
        for kind, key, target in REFERENCES:
            for item in self.items(kind):
                item.index(key, target)
        self._buffers = [self._resolve_buffer(i, item) for i, item in enumerate(self.items("buffers"))]

    def fail(self, problem: str) -> LoadError:
        """The error to raise about the whole file."""
        return LoadError(f"{self.path}: {problem}")

    def items(self, kind: str) -> list[Item]:
        """All items of a kind, such as `nodes`. Raises LoadError if they are no list of objects."""
        if kind not in self._items:
            value = self.root.data.get(kind, [])
            if not isinstance(value, list):
                raise self.fail(f'"{kind}" is {show(value)}, must be a list')
            self._items[kind] = [Item(self, _label(KINDS[kind], i, data), data) for i, data in enumerate(value)]
        return self._items[kind]

    def count(self, kind: str) -> int:
        """How many items of a kind the file has; 0 if they are no list, which items() refuses."""
        value = self.root.data.get(kind, [])
        return len(value) if isinstance(value, list) else 0

    def buffer(self, index: int) -> memoryview:
        """The bytes of a buffer, byteLength of them or a few more."""
        data = self._buffers[index]
        if data is None:
            item = self.items("buffers")[index]
            compressed = "EXT_meshopt_compression" in str(item.data.get("extensions", ""))
            why = "only its EXT_meshopt_compression form is in the file" if compressed else "it has no uri and no data"
            raise item.fail(f"holds no bytes: {why}; export the file without compression")
        return data

    def view(self, index: int) -> memoryview:
        """The bytes of a bufferView."""
        item = self.items("bufferViews")[index]
        start, length = item.integer("byteOffset", 0), item.integer("byteLength", low=1)
        data = self.buffer(item.required_index("buffer", "buffers"))
        if start + length > len(data):
            raise item.fail(
                f"ends at byte {show(start + length)}, its buffer at {len(data)}; the file is cut short or broken"
            )
        return data[start : start + length]

    def read_uri(self, uri: str, owner: Item) -> bytes:
        """The bytes that a uri stands for: a data uri or a file beside the asset, never the network."""
        if uri[:5].lower() == "data:":
            return _decode_data_uri(uri, owner)
        if uri not in self._fetched:
            self._fetched[uri] = _read_file(self._locate(uri, owner), f"{self.path}: {owner.label}")
            self.hash.update(self._fetched[uri])
        return self._fetched[uri]

    def _locate(self, uri: str, owner: Item) -> Path:
        if scheme := re.match(r"[A-Za-z][A-Za-z0-9+.-]*:", uri):
            raise owner.fail(
                f'uri {show(uri)} is remote ("{scheme[0]}") and never fetched; put the file beside the model'
            )
        name = urllib.parse.unquote(uri)
        inside = not os.path.isabs(name) and os.path.normpath(name).split(os.sep)[0] != os.pardir
        if not inside and not self.allow_outside:
            raise owner.fail(f"uri {show(uri)} leaves the folder of the model; allow outside files if you trust it")
        return self.path.parent / name

    def _split_glb(self, data: bytes) -> tuple[memoryview, memoryview | None]:
        """The JSON and BIN chunks of a GLB (glTF 2.0, 4.4)."""
        if len(data) < 12:
            raise self.fail(f"the GLB header needs 12 bytes, the file has {len(data)}: it is cut short")
        version, length = struct.unpack_from("<II", data, 4)
        if version != 2:
            raise self.fail(f"GLB version {version}, only 2 is read; convert it to glTF 2.0")
        if length > len(data):
            raise self.fail(f"the GLB header says {length} bytes, the file has {len(data)}: it is cut short")
        if length < len(data):
            self.report.warn(f"{len(data) - length} bytes after the end of the GLB are ignored")
        text: memoryview | None = None
        binary: memoryview | None = None
        at, number = 12, 0
        while at < length:
            if at + 8 > length:
                raise self.fail(
                    f"GLB chunk {number}: its header needs 8 bytes, {length - at} are left: it is cut short"
                )
            size, kind = struct.unpack_from("<II", data, at)
            at += 8
            if at + size > length:
                raise self.fail(f"GLB chunk {number}: says {size} bytes, {length - at} are left: it is cut short")
            chunk = memoryview(data)[at : at + size]
            if number == 0 and kind != _JSON_CHUNK:
                raise self.fail(f"the first GLB chunk has type 0x{kind:08x}, must be JSON (0x{_JSON_CHUNK:08x})")
            if number == 0:
                text = chunk
            elif kind == _BIN_CHUNK and binary is None:
                binary = chunk
            elif kind in (_JSON_CHUNK, _BIN_CHUNK):  # other types are extensions, which a reader skips
                self.report.warn(f"GLB chunk {number} repeats a type and is ignored")
            at += size
            number += 1
        if text is None:
            raise self.fail("the GLB has no JSON chunk: it is cut short")
        return text, binary

    def _parse(self, text: bytes) -> Any:
        if text[:3] == b"\xef\xbb\xbf":
            self.report.warn("the JSON starts with a byte order mark, which glTF forbids")
            text = text[3:]
        if not text.strip(b" \t\r\n\0"):
            raise self.fail("holds no JSON: the file is empty or not a glTF model")
        try:
            return json.loads(text.decode("utf-8").rstrip("\0"), parse_constant=_refuse_constant)
        except RecursionError:
            raise self.fail("the JSON is nested too deeply to be a glTF model") from None
        except ValueError as error:  # JSONDecodeError, UnicodeDecodeError, a number of too many digits
            raise self.fail(f"not a glTF model: bad JSON: {error}") from None

    def _check_version(self) -> None:
        asset = self.root.child("asset")
        if asset is None:
            raise self.fail('"asset" is missing: not a glTF model')
        version = asset.string("version")
        if not re.fullmatch(r"2\.\d+", version):
            raise self.fail(f"asset.version is {show(version)}, only 2.x is read; convert the file to glTF 2.0")
        if asset.string("minVersion", "2.0") != "2.0":
            raise self.fail(f"needs glTF {show(asset.data['minVersion'])}, 2.0 is read; export it for 2.0")

    def _resolve_buffer(self, index: int, item: Item) -> memoryview | None:
        length = item.integer("byteLength", low=1)
        uri = item.string("uri", None)
        if uri is not None:
            data = memoryview(self.read_uri(uri, item))
        elif index == 0 and self._binary is not None:
            data = self._binary
        else:  # a placeholder: an error only if something reads it
            return None
        if len(data) < length:
            raise item.fail(f"must have {show(length)} bytes, has {len(data)}; the file is cut short or broken")
        return data


def _label(singular: str, index: int, data: Any) -> str:
    name = data.get("name") if isinstance(data, dict) else None
    return f"{singular} {show(name)}" if isinstance(name, str) and name else f"{singular} {index}"


def _refuse_constant(name: str) -> Any:
    raise ValueError(f"{name} is not JSON")


def _read_file(path: Path, what: str) -> bytes:
    try:
        if path.is_dir():
            raise LoadError(f"{what}: {path} is a folder, must be a file")
        if path.exists() and not path.is_file():  # a pipe or device could block for ever
            raise LoadError(f"{what}: {path} is not a plain file")
        return path.read_bytes()
    except FileNotFoundError:
        named = "there is no such file" if what == str(path) else f"there is no file {path}"
        raise LoadError(f"{what}: {named}; check the name and the folder") from None
    except (OSError, ValueError) as error:  # no permission, a name with a NUL, a name too long
        raise LoadError(f"{what}: {path} cannot be read: {error}") from None


def _decode_data_uri(uri: str, owner: Item) -> bytes:
    header, comma, body = uri.partition(",")
    if not comma:
        raise owner.fail(f"uri {show(uri)} is no data uri: it has no comma")
    if not header.lower().endswith(";base64"):
        return urllib.parse.unquote_to_bytes(body)
    try:
        return base64.b64decode(urllib.parse.unquote_to_bytes(body) if "%" in body else body, validate=True)
    except (binascii.Error, ValueError) as error:
        raise owner.fail(f"its data uri is not base64: {error}") from None

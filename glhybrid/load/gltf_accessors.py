"""Accessors to arrays (glTF 2.0, 3.6.2): every component type, interleaved, sparse, normalised, and without a view.

Arrays are windows into the file's bytes wherever their layout allows, so they may be read-only.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glhybrid.load.gltf_document import Document, Item, show
from glhybrid.scene import F32

COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
COMPONENT_NAMES = {
    5120: "BYTE",
    5121: "UNSIGNED_BYTE",
    5122: "SHORT",
    5123: "UNSIGNED_SHORT",
    5125: "UNSIGNED_INT",
    5126: "FLOAT",
}
ELEMENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
# An accessor without bytes costs the file nothing whatever its count: 2^24 elements is past any model.
MAX_EMPTY_COUNT = 1 << 24


@dataclass(frozen=True, eq=False)
class Accessor:
    """raw: (count, width) as stored; matrices column by column."""

    raw: NDArray[Any]
    type: str
    component: int
    normalized: bool

    def describe(self) -> str:
        """Its type in words, for messages."""
        return f"{self.type} of {'normalised ' if self.normalized else ''}{COMPONENT_NAMES[self.component]}"

    def floats(self) -> F32:
        """(count, width) float32, C-contiguous: normalised integers to [0, 1] or [-1, 1], others as they are."""
        if self.raw.dtype == np.float32 or not self.normalized:
            return np.ascontiguousarray(self.raw, np.float32)
        scale = np.float32(1.0 / np.iinfo(self.raw.dtype).max)
        values = self.raw.astype(np.float32)
        values *= scale
        return np.maximum(values, np.float32(-1.0), out=values)  # -128 and -127 both mean -1


class AccessorReader:
    """Reads accessors of one document, each once."""

    def __init__(self, doc: Document) -> None:
        self.doc = doc
        self._read: dict[int, Accessor] = {}
        self._floats: dict[int, F32] = {}

    def get(self, index: int) -> Accessor:
        """An accessor's values, read once. Raises LoadError."""
        if index not in self._read:
            self._read[index] = _read(self.doc, self.doc.items("accessors")[index])
        return self._read[index]

    def attribute(self, owner: Item, key: str, types: str, count: int | None = None) -> F32 | None:
        """The floats of the accessor under owner[key]; None where the key is absent.

        types: those allowed, by blanks. count: the number of elements it must have.
        """
        index = owner.index(key, "accessors")
        if index is None:
            return None
        self.check(owner, key, types, count)
        if index not in self._floats:
            self._floats[index] = self.get(index).floats()
        return self._floats[index]

    def check(self, owner: Item, key: str, types: str, count: int | None = None) -> Accessor:
        """The accessor under owner[key], of one of the types and the wanted count."""
        accessor = self.get(owner.required_index(key, "accessors"))
        if accessor.type not in types.split():
            raise owner.fail(f"{key} is {accessor.describe()}, must be {types.replace(' ', ' or ')}")
        if count is not None and len(accessor.raw) != count:
            raise owner.fail(f"{key} has {len(accessor.raw)} elements, must have {count}; the file is broken")
        return accessor

    def unsigned(self, owner: Item, key: str, types: str, count: int | None = None) -> NDArray[Any]:
        """The unsigned integers of the accessor under owner[key], as stored."""
        accessor = self.check(owner, key, types, count)
        if accessor.raw.dtype.kind != "u":
            raise owner.fail(f"{key} is {accessor.describe()}, must be of unsigned integers")
        return accessor.raw


def _read(doc: Document, item: Item) -> Accessor:
    component = item.integer("componentType")
    if component not in COMPONENTS:
        known = ", ".join(f"{code} ({COMPONENT_NAMES[code]})" for code in COMPONENTS)
        raise item.fail(f'"componentType" is {show(component)}, must be one of {known}')
    kind = item.string("type")
    if kind not in ELEMENTS:
        raise item.fail(f'"type" is {show(kind)}, must be one of {", ".join(ELEMENTS)}')
    count = item.integer("count")
    dtype = np.dtype(COMPONENTS[component])
    view = item.index("bufferView", "bufferViews")
    raw: NDArray[Any]
    if view is not None:
        raw = _from_view(doc, item, view, item.integer("byteOffset", 0), dtype, kind, count)
    elif count > MAX_EMPTY_COUNT:
        raise item.fail(f'"count" is {show(count)} without a bufferView, must be <= {MAX_EMPTY_COUNT}')
    else:
        raw = np.zeros((count, ELEMENTS[kind]), dtype)
    sparse = item.child("sparse")
    if sparse is not None:
        raw = _with_sparse(doc, sparse, raw, dtype, kind)
    return Accessor(raw, kind, component, item.boolean("normalized"))


def _from_view(
    doc: Document, item: Item, view: int, offset: int, dtype: np.dtype[Any], kind: str, count: int, strided: bool = True
) -> NDArray[Any]:
    """(count, width) window into a bufferView. Matrix columns start at multiples of four bytes (3.6.2.4)."""
    data = doc.view(view)
    rows = int(kind[3]) if kind.startswith("MAT") else ELEMENTS[kind]
    columns = ELEMENTS[kind] // rows
    column_stride = rows * dtype.itemsize if columns == 1 else -(-rows * dtype.itemsize // 4) * 4
    size = column_stride * (columns - 1) + rows * dtype.itemsize
    stride = doc.items("bufferViews")[view].integer("byteStride", 0, high=65535) if strided else 0
    stride = stride or column_stride * columns
    if stride < size:
        raise item.fail(f"byteStride {stride} of bufferView {view} is less than the {size} bytes of one {kind}")
    end = offset + stride * (count - 1) + size if count else 0
    if end > len(data):
        raise item.fail(f"{show(count)} elements end at byte {show(end)} of bufferView {view}, which has {len(data)}")
    window = np.ndarray((count, columns, rows), dtype, data, offset, (stride, column_stride, dtype.itemsize))
    if not window.flags.aligned:
        window = window.copy()
    return window.reshape(count, columns * rows)


def _with_sparse(doc: Document, sparse: Item, base: NDArray[Any], dtype: np.dtype[Any], kind: str) -> NDArray[Any]:
    """A copy of base with some elements replaced (3.6.2.3)."""
    count = sparse.integer("count", low=1)
    indices, values = sparse.child("indices"), sparse.child("values")
    if indices is None or values is None:
        raise sparse.fail('"indices" or "values" is missing')
    code = indices.integer("componentType")
    if code not in (5121, 5123, 5125):
        raise indices.fail(f'"componentType" is {show(code)}, must be 5121, 5123 or 5125 (unsigned)')
    at = _from_view(
        doc, indices, indices.required_index("bufferView", "bufferViews"), indices.integer("byteOffset", 0),
        np.dtype(COMPONENTS[code]), "SCALAR", count, strided=False,
    )[:, 0]  # fmt: skip
    new = _from_view(
        doc, values, values.required_index("bufferView", "bufferViews"), values.integer("byteOffset", 0),
        dtype, kind, count, strided=False,
    )  # fmt: skip
    if at.max() >= len(base):
        raise indices.fail(f"index {at.max()} is past the last element ({len(base) - 1})")
    result = base.copy()
    result[at] = new
    return result

"""PLY (Turk 1994) elements as arrays: text and both binary byte orders.

Rows with lists have no fixed size. All of one size, as nearly every file has them, are read as one array; else a walk
finds where each row starts, and rows of equal size are read together.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glhybrid.errors import LoadError

TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
         "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
         "float32": "f4", "float64": "f8"}  # fmt: skip
MAX_LIST = 1 << 20  # values in one list: past any polygon or strip, and so a sign of a broken file
BYTE_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True)
class Property:
    """A column of an element, as the header declares it."""

    name: str
    type: str  # NumPy's, without byte order
    count_type: str = ""  # of a list; "" = one value


@dataclass(frozen=True)
class Element:
    """columns: (N,) values of each single property. lists: values of each list property laid end to end, and (N,)
    their counts."""

    columns: dict[str, NDArray[Any]]
    lists: dict[str, tuple[NDArray[Any], NDArray[np.int64]]]


def read_ply(path: Path, data: bytes) -> dict[str, Element]:
    """Elements by name. Raises LoadError where the header is none, or the body shorter than it says."""
    order, layout, start = _read_header(path, data)
    elements = {}
    name, at = "", 0
    try:
        body = _Binary(data[start:], BYTE_ORDERS[order]) if BYTE_ORDERS[order] else _Text(data[start:])
        for name, (count, properties) in layout.items():
            elements[name], at = _read_element(body, at, count, properties)
    except (ValueError, IndexError, OverflowError, MemoryError) as error:
        raise LoadError(f'{path}: element "{name}": {error}; the file is cut short or broken') from None
    return elements


def _read_header(path: Path, data: bytes) -> tuple[str, dict[str, tuple[int, list[Property]]], int]:
    """The byte order, count and properties by element, and where the body starts."""
    end = data.find(b"end_header")
    if data[:3] != b"ply" or end < 0:
        raise LoadError(f'{path}: has no PLY header ("ply" to "end_header"): empty, cut short or not a PLY file')
    start = end + len(b"end_header")
    start += 2 if data[start : start + 2] == b"\r\n" else 1
    order = ""
    layout: dict[str, tuple[int, list[Property]]] = {}
    last: list[Property] = []
    for number, line in enumerate(data[:end].decode("latin-1").splitlines()[1:], 2):
        try:
            match line.split():
                case ["format", name, _] if name in BYTE_ORDERS:
                    order = name
                case ["element", name, count] if int(count) >= 0:
                    last = []
                    layout[name] = (int(count), last)
                case ["property", "list", count_type, item_type, name] if layout and TYPES[count_type][0] in "iu":
                    last.append(Property(name, TYPES[item_type], TYPES[count_type]))
                case ["property", item_type, name] if layout:
                    last.append(Property(name, TYPES[item_type]))
                case [] | ["comment" | "obj_info", *_]:
                    pass
                case _:
                    raise ValueError
        except (ValueError, KeyError):
            raise LoadError(f'{path}: line {number}: "{line[:60]}" has no meaning in a PLY header') from None
    if not order:
        raise LoadError(f'{path}: its header lacks "format ascii" or "format binary_..."')
    return order, layout, start


class _Text:
    """The body of a text file: an array of numbers."""

    def __init__(self, data: bytes) -> None:
        self.flat = np.array(list(map(float, data.split())))

    def list_size(self, at: int, _: Property) -> tuple[int, int]:
        """The length of the list at a place, and how many units that length takes up."""
        return _list_size(float(self.flat[at])), 1

    def size(self, properties: list[Property], sizes: tuple[int, ...]) -> int:
        """The units that a row takes whose lists have these sizes."""
        return sum(s + bool(p.count_type) for p, s in zip(properties, sizes, strict=True))

    def gather(self, at: NDArray[np.int64], properties: list[Property], sizes: tuple[int, ...]) -> list[NDArray[Any]]:
        """(R, size) values of each property, of rows at these places."""
        columns, offset = [], 0
        for p, size in zip(properties, sizes, strict=True):
            offset += bool(p.count_type)
            columns.append(self.flat[at[:, None] + np.arange(offset, offset + size)].astype(p.type))
            offset += size
        return columns


class _Binary:
    """The body of a binary file: an array of bytes."""

    def __init__(self, data: bytes, byte_order: str) -> None:
        self.flat, self.byte_order = np.frombuffer(data, np.uint8), byte_order

    def list_size(self, at: int, p: Property) -> tuple[int, int]:
        head = np.dtype(self.byte_order + p.count_type)
        if at + head.itemsize > len(self.flat):
            raise ValueError("ends within a row")
        value = int(self.flat[at]) if head.itemsize == 1 else self.flat[at : at + head.itemsize].view(head)[0]
        return _list_size(int(value)), head.itemsize

    def size(self, properties: list[Property], sizes: tuple[int, ...]) -> int:
        return self._row(properties, sizes).itemsize

    def _row(self, properties: list[Property], sizes: tuple[int, ...]) -> np.dtype[Any]:
        fields: list[Any] = []
        for i, (p, size) in enumerate(zip(properties, sizes, strict=True)):
            if p.count_type:
                fields.append((f"count{i}", self.byte_order + p.count_type))
            fields.append((f"{i}", self.byte_order + p.type, (size,)))
        return np.dtype(fields)

    def gather(self, at: NDArray[np.int64], properties: list[Property], sizes: tuple[int, ...]) -> list[NDArray[Any]]:
        row = self._row(properties, sizes)
        if len(at) == 1 or np.all(np.diff(at) == row.itemsize):
            table = self.flat[at[0] : at[0] + row.itemsize * len(at)].view(row)
        else:
            table = self.flat[at[:, None] + np.arange(row.itemsize)].view(row)[:, 0]
        columns = [table[f"{i}"] for i in range(len(properties))]
        return [c.astype(c.dtype.newbyteorder("=")) for c in columns]


def _list_size(value: float) -> int:
    if not 0 <= value <= MAX_LIST or value != int(value):
        raise ValueError(f"a list of {value} values, must be 0 to {MAX_LIST}")
    return int(value)


def _read_element(body: _Text | _Binary, at: int, count: int, properties: list[Property]) -> tuple[Element, int]:
    """An element that starts at a place, and where it ends."""
    if not properties or not count:
        empty, none = np.zeros(0), np.zeros(0, np.int64)
        lists = {p.name: (empty, none) for p in properties if p.count_type}
        return Element({p.name: empty for p in properties if not p.count_type}, lists), at
    if count > len(body.flat) - at:  # a row takes a unit at least; checked before anything of that length is made
        raise ValueError(f"has {count} rows by its header, {len(body.flat) - at} bytes or words are left")
    starts, kind, shapes, end = _find_rows(body, at, count, properties)
    if end > len(body.flat):
        raise ValueError(f"its rows end at {end}, the body at {len(body.flat)}")
    groups = [(np.flatnonzero(kind == k), sizes) for k, sizes in enumerate(shapes)]
    gathered = [body.gather(starts[rows], properties, sizes) for rows, sizes in groups]
    element = Element({}, {})
    for i, p in enumerate(properties):
        lengths = np.array([sizes[i] for sizes in shapes])[kind]
        first = np.cumsum(lengths) - lengths
        values = np.zeros(int(lengths.sum()), p.type)
        for (rows, sizes), columns in zip(groups, gathered, strict=True):
            values[first[rows][:, None] + np.arange(sizes[i])] = columns[i]
        if p.count_type:
            element.lists[p.name] = values, lengths
        else:
            element.columns[p.name] = values
    return element, end


def _find_rows(
    body: _Text | _Binary, at: int, count: int, properties: list[Property]
) -> tuple[NDArray[np.int64], NDArray[np.int64], list[tuple[int, ...]], int]:
    """Where each row starts; which of the shapes (list sizes) it has; the shapes; and where the last row ends."""
    sizes, _ = _shape(body, at, properties)
    step = body.size(properties, sizes)
    end = at + step * count
    starts = at + step * np.arange(count)
    if not any(p.count_type for p in properties) or (
        end <= len(body.flat) and _all_like(body, starts, properties, sizes)
    ):
        return starts, np.zeros(count, np.int64), [sizes], end
    shapes: dict[tuple[int, ...], int] = {}
    kind = np.zeros(count, np.int64)
    for i in range(count):
        starts[i] = at
        sizes, at = _shape(body, at, properties)
        kind[i] = shapes.setdefault(sizes, len(shapes))
    return starts, kind, list(shapes), at


def _shape(body: _Text | _Binary, at: int, properties: list[Property]) -> tuple[tuple[int, ...], int]:
    """The list sizes of the row at a place (1 for single values), and where it ends."""
    sizes = []
    for i, p in enumerate(properties):
        size = 1
        if p.count_type:
            size, _ = body.list_size(at, p)
        sizes.append(size)
        at += body.size(properties[i : i + 1], (size,))
    return tuple(sizes), at


def _all_like(
    body: _Text | _Binary, starts: NDArray[np.int64], properties: list[Property], sizes: tuple[int, ...]
) -> bool:
    """Whether rows of equal length at these places all have lists of these sizes."""
    offset = 0
    for i, p in enumerate(properties):
        if p.count_type:
            probe = Property("", p.count_type)
            (found,) = body.gather(starts + offset, [probe], (1,))
            if np.any(found[:, 0] != sizes[i]):
                return False
        offset += body.size([p], (sizes[i],))
    return True

"""Boxes of 16 bits for compiled code: unions and exchanges of whole rows as vectors, centroids, areas.

A row is (8,) uint16: 65535 - low corner, high corner, and two words that boxes carry along (see fragments.py), so that
a union is a maximum. Numba's vectoriser does not find these in plain Python.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

_simd: Callable[[Any], Any] = intrinsic
_LANES = ir.VectorType(ir.IntType(16), 8)


def _lanes(context: Any, builder: Any, array_type: Any, array: Any, row: Any) -> Any:
    """Pointer to row `row` of a (N, 8) uint16 array as one vector."""
    data = context.make_array(array_type)(context, builder, array).data
    return builder.gep(builder.bitcast(data, _LANES.as_pointer()), [row])


def _load(builder: Any, pointer: Any) -> Any:
    value = builder.load(pointer)
    value.align = 2
    return value


def _store(builder: Any, value: Any, pointer: Any) -> None:
    builder.store(value, pointer).align = 2


def _merge_into(builder: Any, pointer: Any, value: Any) -> None:
    old = _load(builder, pointer)
    _store(builder, builder.select(builder.icmp_unsigned(">", old, value), old, value), pointer)


@_simd
def clear(typing: Any, boxes: Any, i: Any) -> Any:
    """boxes[i] = the empty box."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        _store(builder, ir.Constant(_LANES, [0] * 8), _lanes(context, builder, signature.args[0], *args))
        return context.get_dummy_value()

    return types.void(boxes, types.intp), generate


@_simd
def merge(typing: Any, boxes: Any, i: Any, source: Any, j: Any) -> Any:
    """boxes[i] = union of boxes[i] and source[j]."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        value = _load(builder, _lanes(context, builder, signature.args[2], args[2], args[3]))
        _merge_into(builder, _lanes(context, builder, signature.args[0], args[0], args[1]), value)
        return context.get_dummy_value()

    return types.void(boxes, types.intp, source, types.intp), generate


@_simd
def merge_centroid(typing: Any, boxes: Any, i: Any, source: Any, j: Any) -> Any:
    """boxes[i] = union of boxes[i] and the centroid of source[j], as `centroid` below has it, with 65534 - low."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        half = builder.lshr(
            _load(builder, _lanes(context, builder, signature.args[2], args[2], args[3])), ir.Constant(_LANES, [1] * 8)
        )
        turn = ir.Constant(ir.VectorType(ir.IntType(32), 8), [3, 4, 5, 0, 1, 2, 6, 7])
        other = builder.shuffle_vector(half, half, turn)
        value = builder.add(builder.sub(half, other), ir.Constant(_LANES, [32767] * 8))
        _merge_into(builder, _lanes(context, builder, signature.args[0], args[0], args[1]), value)
        return context.get_dummy_value()

    return types.void(boxes, types.intp, source, types.intp), generate


@_simd
def swap(typing: Any, boxes: Any, i: Any, j: Any) -> Any:
    """Exchange boxes[i] and boxes[j]."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        a = _lanes(context, builder, signature.args[0], args[0], args[1])
        b = _lanes(context, builder, signature.args[0], args[0], args[2])
        x, y = _load(builder, a), _load(builder, b)
        _store(builder, x, b)
        _store(builder, y, a)
        return context.get_dummy_value()

    return types.void(boxes, types.intp, types.intp), generate


@njit
def centroid(boxes, i, axis):  # type: ignore[no-untyped-def]
    """(lo + hi) / 2 in grid units, 0..65534."""
    return np.int64(boxes[i, 3 + axis] >> 1) - np.int64(boxes[i, axis] >> 1) + 32767


@njit
def half_area(boxes, i, step):  # type: ignore[no-untyped-def]
    """Half the surface area. step: (3,) float32, grid cells in units of the largest, so that nothing overflows."""
    x = np.float32(np.int32(boxes[i, 0]) + np.int32(boxes[i, 3]) - np.int32(65535)) * step[0]
    y = np.float32(np.int32(boxes[i, 1]) + np.int32(boxes[i, 4]) - np.int32(65535)) * step[1]
    z = np.float32(np.int32(boxes[i, 2]) + np.int32(boxes[i, 5]) - np.int32(65535)) * step[2]
    return x * y + y * z + z * x

"""Values of animation channels at a time: keys of many channels kept together, so that a frame samples all at once.

Interpolation is that of glTF 2.0, appendix C. Times outside a channel's keys are clamped to its first and last.
Everything is float64.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from glhybrid.scene import F64, Channel


def sample(channel: Channel, time: float) -> F64:
    """(W,) float64 value of one channel; rotations come out as unit quaternions."""
    return Tracks((channel,)).at(time)[0]


MANY = 1024  # channels, nodes or instances from which on compiled code (swarm.py) is worth loading for one look


class Tracks:
    """Channels of one path, interpolation and number of values, end to end.

    nodes: (C,) int64. Key k of channel c is row first[c] + k of `times` (K,) and of `values` (K, W), or (K, 3, W) with
    tangents. The search for a time is one binary search over all channels, whose keys may lie anywhere.
    """

    def __init__(self, channels: Sequence[Channel]) -> None:
        self.path, self.interpolation = channels[0].path, channels[0].interpolation
        self.nodes = np.array([c.node for c in channels], np.int64)
        counts = np.array([len(c.times) for c in channels], np.int64)
        self._end = np.cumsum(counts)
        self._first = self._end - counts
        self._steps = int(counts.max()).bit_length()
        self._times = np.concatenate([c.times for c in channels]).astype(np.float64)
        self._values = np.concatenate([c.values for c in channels]).astype(np.float64)
        self._turns = self.path == "rotation"
        if self._turns and self.interpolation != "CUBICSPLINE":
            self._values = unit_quaternions(self._values)
        self._given: Any = None  # what `into` hands to compiled code

    def at(self, time: float) -> F64:
        """(C, W) float64."""
        if len(self.nodes) >= MANY:
            return self._compiled(float(time))
        after = self._after(float(time))
        before = np.maximum(after - 1, self._first)
        cubic = self.interpolation == "CUBICSPLINE"
        value = self._values[before, 1] if cubic else self._values[before]
        between = (after > self._first) & (after < self._end)
        if self.interpolation != "STEP" and between.any():
            if between.all():
                value = self._between(before, after, time)
            else:
                value[between] = self._between(before[between], after[between], time)
        return unit_quaternions(value) if cubic and self._turns else value

    def _compiled(self, time: float) -> F64:
        out = np.empty((len(self.nodes), self._values.shape[-1]))
        self.into(out, time, np.arange(len(out)))
        return out

    def into(self, out: F64, time: float, rows: Any = None) -> None:
        """The same, compiled, into the rows of out (N, W) that are given (C,) int64, or into those of the nodes."""
        if self._given is None:
            from glhybrid import swarm

            values = self._values if self.interpolation == "CUBICSPLINE" else self._values[:, None]
            turn = {"LINEAR": "SLERP", "CUBICSPLINE": "CUBIC_TURN"} if self._turns else {}
            kind = swarm.KINDS[turn.get(self.interpolation, self.interpolation)]
            self._given = swarm, (self._times, np.ascontiguousarray(values), self._first, self._end), kind
        (code, given, kind), rows = self._given, self.nodes if rows is None else rows
        code.spread(lambda first, last: code.sample(*given, rows, time, kind, first, last, out), 0, len(self.nodes))

    def _after(self, time: float) -> Any:
        """(C,) row of each channel's first key later than the time; its end if there is none."""
        low, high = self._first.copy(), self._end.copy()
        for _ in range(self._steps):
            middle = (low + high) >> 1
            later = self._times[np.minimum(middle, self._end - 1)] > time
            searching = low < high
            high = np.where(searching & later, middle, high)
            low = np.where(searching & ~later, middle + 1, low)
        return low

    def _between(self, before: Any, after: Any, time: float) -> F64:
        start, step = self._times[before], self._times[after] - self._times[before]
        u = ((time - start) / step)[:, None]
        if self.interpolation == "CUBICSPLINE":
            leave, arrive = step[:, None] * self._values[before, 2], step[:, None] * self._values[after, 0]
            first, second = self._values[before, 1], self._values[after, 1]
            return np.asarray(
                (2 * u**3 - 3 * u**2 + 1) * first + (u**3 - 2 * u**2 + u) * leave
                + (3 * u**2 - 2 * u**3) * second + (u**3 - u**2) * arrive
            )  # fmt: skip
        first, second = self._values[before], self._values[after]
        return slerp(first, second, u) if self._turns else np.asarray((1 - u) * first + u * second)


def tracks(channels: Sequence[Channel]) -> list[Tracks]:
    """All channels that are to be sampled together. Of two for one property of a node the last one wins."""
    chosen = {(c.node, c.path): c for c in channels}.values()
    groups: dict[tuple[Any, ...], list[Channel]] = {}
    for channel in chosen:
        groups.setdefault((channel.path, channel.interpolation, channel.values.shape[1:]), []).append(channel)
    return [Tracks(group) for group in groups.values()]


def sampled(groups: Sequence[Tracks], time: float) -> Iterator[tuple[str, Any, F64]]:
    """(path, nodes (C,), values (C, W)) of every group at a time in seconds."""
    return ((group.path, group.nodes, group.at(time)) for group in groups)


def slerp(a: F64, b: F64, u: Any) -> F64:
    """The quaternions (..., 4) u of the shorter way from a to b, all unit; exact at both ends, and for nearly equal
    ones. u: (..., 1), or a number."""
    b = np.where((a * b).sum(-1, keepdims=True) < 0, -b, b)
    # acos of the product loses small angles
    apart, together = (np.sqrt((d * d).sum(-1, keepdims=True)) for d in (a - b, a + b))
    angle = 2 * np.arctan2(apart, together)
    near = angle < 1e-9
    sine = np.where(near, 1.0, np.sin(angle))
    left, right = (np.where(near, w, np.sin(w * angle) / sine) for w in (1 - u, u))
    return unit_quaternions(left * a + right * b)


def unit_quaternions(q: F64) -> F64:
    """(..., 4) of length 1; the one that turns nothing where there is no length."""
    length = np.sqrt((q * q).sum(-1, keepdims=True))
    some = length > 1e-30
    return np.asarray(np.where(some, q / np.where(some, length, 1.0), (0.0, 0.0, 0.0, 1.0)))

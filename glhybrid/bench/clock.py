"""Times of GPU work, three clocks side by side, because each of them lies somewhere.

- GL timestamps: what a GPU itself says. Software rasterisers report almost nothing for half a second of work.
- Wall time around finish(): true everywhere, but on a busy machine it measures the neighbours.
- CPU seconds of the process: what a software rasteriser spent, on all threads; divided by the cores it is the time on
  an idle machine.

A GPU with only an OpenGL context lowers its clock within two seconds of idling, five times on some, and raises it again
only under unpaced load. So all launches of a measurement are queued behind a warm-up without a pause, and their queries
are read at the end.
"""

import ctypes
import math
import os
import time
from collections.abc import Callable, Hashable, Mapping
from ctypes import c_uint, c_uint64
from dataclasses import dataclass, field
from typing import TypeVar
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from glhybrid.context import Context
from glhybrid.gl import GL_QUERY_RESULT, GL_TIMESTAMP
from glhybrid.timing import T, Timing

WARM_UP_S = 0.5  # of unpaced work: an H100 needs 0.29 s to reach its clock
QUEUED_S = 0.1  # of work between two ends: enough not to let the clock fall
HOT_S = 0.25  # after unpaced work, a GPU still has its clock
LAUNCHES_AT_ONCE = 4  # between two looks at the time during warm-up
_worked: "WeakKeyDictionary[Context, float]" = WeakKeyDictionary()  # when unpaced work ended
K = TypeVar("K", bound=Hashable)
Work = Callable[[], object]


@dataclass
class Sample:
    """Times of one piece of work, ms a launch. gpu is empty without timer queries; wall and cpu may be means
    over batches."""

    wall: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)
    gpu: list[float] = field(default_factory=list)
    batch: int = 1

    def median(self, clock: str) -> float:
        """Milliseconds a launch. clock: "wall", "cpu" or "gpu"."""
        return float(np.median(getattr(self, clock)))

    def spread(self, clock: str) -> float:
        """Distance between the quartiles, as a share of the median."""
        low, middle, high = np.percentile(getattr(self, clock), (25, 50, 75))
        return float((high - low) / middle) if middle > 0 else 0.0


def cores(context: Context | None = None) -> int:
    """Threads that a software rasteriser works on: the processors of this process, or what LP_NUM_THREADS says."""
    asked = os.environ.get("LP_NUM_THREADS", "")
    if context is not None and "llvmpipe" in context.device.renderer and asked.isdecimal():
        return max(int(asked), 1)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def on_cpu(works: Mapping[K, Work], repeats: int, finish: Work = lambda: None) -> dict[K, Sample]:
    """Runs everything in turns, so that a noisy neighbour meets all alike. Each is run once before, untimed."""
    samples = {key: Sample() for key in works}
    for work in works.values():
        work()
    finish()
    for _ in range(repeats):
        for key, work in works.items():
            wall, cpu = time.perf_counter(), time.process_time()
            work()
            finish()
            samples[key].cpu.append((time.process_time() - cpu) * 1e3)
            samples[key].wall.append((time.perf_counter() - wall) * 1e3)
    return samples


def warm_up(context: Context, work: Work, seconds: float = WARM_UP_S) -> float:
    """Seconds a launch. Works until a GPU has reached its clock, with QUEUED_S queued at most; once in software."""
    started = time.perf_counter()
    launches, until = (
        1,
        started + (min(seconds, QUEUED_S) if started - _worked.get(context, -math.inf) < HOT_S else seconds),
    )
    while True:
        started = time.perf_counter()
        for _ in range(launches):
            work()
        context.gl.finish()
        now = time.perf_counter()
        if context.device.software or now >= until:
            _worked[context] = now
            return (now - started) / launches
        if now - started < QUEUED_S / 2:
            launches *= 2


def unpaced(
    context: Context, work: Work, least: int, seconds: float = 0.0, batch: int = 1, most_s: float = math.inf
) -> Sample:
    """Warms up, then times batches of launches from finish() to finish(): at least so many launches, and so long.

    batch: launches at most, as many as fit in QUEUED_S. most_s: after so long two batches are enough.
    """
    batch = max(1, min(batch, int(QUEUED_S / max(warm_up(context, work), 1e-6))))
    sample, started, finish = Sample(batch=batch), time.perf_counter(), context.gl.finish
    while True:
        spent, batches = time.perf_counter() - started, len(sample.wall)
        if (batches * batch >= least and spent >= seconds) or (batches >= 2 and spent >= most_s):
            _worked[context] = time.perf_counter()
            return sample
        wall, cpu = time.perf_counter(), time.process_time()
        for _ in range(batch):
            work()
        finish()
        sample.cpu.append((time.process_time() - cpu) / batch * 1e3)
        sample.wall.append((time.perf_counter() - wall) / batch * 1e3)


def on_gpu(context: Context, works: Mapping[K, Work], repeats: int, warm_up_s: float = WARM_UP_S) -> dict[K, Sample]:
    """Warms up with all of it, then queues `repeats` launches of each, every one between two timestamps."""
    if not works:
        return {}
    gl, started = context.raw, time.perf_counter()
    while True:
        for work in works.values():
            for _ in range(LAUNCHES_AT_ONCE):
                work()
        gl.glFinish()
        if time.perf_counter() - started >= warm_up_s:
            break
    count = len(works) * repeats * 2
    queries = (c_uint * count)()
    gl.glGenQueries(count, queries)
    samples, at = {key: Sample() for key in works}, 0
    for key, work in works.items():
        wall, cpu = time.perf_counter(), time.process_time()
        for _ in range(repeats):
            gl.glQueryCounter(queries[at], GL_TIMESTAMP)
            work()
            gl.glQueryCounter(queries[at + 1], GL_TIMESTAMP)
            at += 2
        gl.glFinish()
        samples[key].wall.append((time.perf_counter() - wall) / repeats * 1e3)
        samples[key].cpu.append((time.process_time() - cpu) / repeats * 1e3)
    stamps = _stamps(context, queries)
    spans = (stamps[1::2].astype(np.float64) - stamps[0::2].astype(np.float64)).reshape(-1, repeats) / 1e6
    for key, span in zip(works, spans, strict=True):
        # A driver that says half of what really passed is not believed.
        if np.median(span) > 0.5 * samples[key].wall[0]:
            samples[key].gpu = span.tolist()
    return samples


class PassClock(Timing):
    """Milliseconds by pass as GL timestamps have it: nothing is finished in between, so that a pass of a tenth of a
    millisecond is not drowned by its own end. Of queued passes; for GPUs."""

    def __init__(self, context: Context) -> None:
        super().__init__(context.gl.finish)
        self._context = context
        self._open: list[tuple[dict[str, float], str, c_uint, c_uint]] = []

    def run(self, name: str, work: Callable[[], T]) -> T:
        """The result of work(), queued between two timestamps."""
        if not self.enabled:
            return work()
        gl, first, last = self._context.raw, c_uint(0), c_uint(0)
        gl.glGenQueries(1, ctypes.byref(first))
        gl.glGenQueries(1, ctypes.byref(last))
        gl.glQueryCounter(first, GL_TIMESTAMP)
        result = work()
        gl.glQueryCounter(last, GL_TIMESTAMP)
        self._open.append((self._frames[-1], name, first, last))
        return result

    def medians(self) -> dict[str, float]:
        """By pass, over all frames but the first. Waits for them."""
        if self._open:
            names = (c_uint * (2 * len(self._open)))(*(q.value for row in self._open for q in row[2:]))
            spans = np.diff(_stamps(self._context, names).astype(np.float64).reshape(-1, 2))[:, 0] / 1e6
            for (frame, name, *_), ms in zip(self._open, spans.tolist(), strict=True):
                frame[name] = frame.get(name, 0.0) + ms
            self._open.clear()
        return super().medians()


def pass_clock(context: Context) -> Timing:
    """What times the passes of a frame on this device."""
    return Timing(context.gl.finish) if context.device.software else PassClock(context)


def _stamps(context: Context, queries: "ctypes.Array[c_uint]") -> NDArray[np.uint64]:
    """Nanoseconds of timestamp queries, which are then deleted. Waits for them."""
    gl, count, value = context.raw, len(queries), c_uint64(0)
    stamps = np.zeros(count, np.uint64)
    for i in range(count):
        gl.glGetQueryObjectui64v(queries[i], GL_QUERY_RESULT, ctypes.byref(value))
        stamps[i] = value.value
    gl.glDeleteQueries(count, queries)
    return stamps

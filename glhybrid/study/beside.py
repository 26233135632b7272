"""Processes beside a study on a GPU: they compile its programs ahead, and make what is not timed.

Most of a study's time there is compilation, on one core a process. Each has a context of its own; what it compiles is
kept on disk (program_cache.py), and so are stability curves and cases of the failure library (store.py), where the
study finds them: nothing else passes between them, and what one could not make is made by the study. While frames are
timed all of them stand still.
"""

import itertools
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, wait
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from queue import PriorityQueue
from threading import Thread
from typing import Protocol

from glhybrid import interrupts
from glhybrid.errors import GlhybridError
from glhybrid.renderer import Renderer
from glhybrid.study import helper

MOST = 12  # processes: each compiles, and holds a context
COMMAND = "from glhybrid.study.beside import serve; serve()"
LOOK_S = 0.2  # between two looks at the clock
STALL_S = 90.0  # without a job done, whatever keeps them: the rest is then made by the study
STOP_S = 0.5  # that processes are waited for that are to stand still
SETTLE_S = 0.005  # until a GPU has done what it was told by a process that stands still


@dataclass(frozen=True)
class Home:
    """What all jobs of a study have in common."""

    device: str
    output: Path
    quick: bool


class Job(Protocol):
    """Something to be made: plain values that can be pickled."""

    def make(self, renderer: Renderer, home: Home) -> None:
        """In the process."""


class Crew:
    """Close it, so that its processes end; what is not finished is given up."""

    def __init__(self, home: Home, processes: int) -> None:
        self._home, self._numbers = home, itertools.count()
        self._jobs: PriorityQueue[tuple[int, int, Job | None, Future[None]]] = PriorityQueue()
        self._all: list[Future[None]] = []
        self._running: list[subprocess.Popen[bytes]] = []
        self._threads: list[Thread] = []
        self._left = processes
        self._folder = tempfile.TemporaryDirectory(prefix="glhybrid-study-")
        try:
            with interrupts.deferred():
                for _ in range(processes):  # no lock of the driver's own cache may be held by one that stands still
                    self._running.append(helper.start(COMMAND, nice=10, __GL_SHADER_DISK_CACHE="0"))
                self._threads += [Thread(target=self._feed, args=(popen,), daemon=True) for popen in self._running]
                for thread in self._threads:
                    thread.start()
        except BaseException:
            self.close()
            raise

    @property
    def processes(self) -> int:
        """How many there are."""
        return len(self._running)

    def hand_out(self, thing: object) -> Path:
        """A file with something pickled, for all jobs to read; gone with the crew."""
        path = Path(self._folder.name) / str(next(self._numbers))
        path.write_bytes(pickle.dumps(thing, pickle.HIGHEST_PROTOCOL))
        return path

    def put(self, job: Job, first: bool = False) -> "Future[None]":
        """Makes it, after what was put before; first: before all that was not."""
        done: Future[None] = Future()
        self._all.append(done)
        self._jobs.put((0 if first else 1, next(self._numbers), job, done))
        return done

    @contextmanager
    def paused(self) -> Iterator[None]:
        """All stand still, and the device is ours."""
        try:
            for popen in self._running:
                popen.send_signal(signal.SIGSTOP)
            until = time.monotonic() + STOP_S
            while not all(map(helper.stands, self._running)) and time.monotonic() < until:
                time.sleep(SETTLE_S)  # who waits for a core hears it late
            time.sleep(SETTLE_S)
            yield
        finally:
            for popen in self._running:
                popen.send_signal(signal.SIGCONT)

    def wait(self, told: Callable[[], None], some: "Future[None] | None" = None) -> None:
        """Until one job is done, or all are; not longer than STALL_S without one that is. told: now and then."""
        moved, left = time.monotonic(), len(self._all)
        while waiting := [f for f in ([some] if some else self._all) if not f.done()]:
            now_left = sum(not f.done() for f in self._all)
            if now_left != left:
                left, moved = now_left, time.monotonic()
            if not self._left or time.monotonic() - moved > STALL_S:
                return
            told()
            wait(waiting, LOOK_S)

    def close(self) -> None:
        """Ends them all."""
        for popen in self._running:
            popen.kill()
        for _ in self._threads:
            self._jobs.put((-1, next(self._numbers), None, Future()))
        for thread in self._threads:
            if thread.ident is not None:  # else it was never started
                thread.join()
        for popen in self._running:
            popen.communicate()  # closes its pipes
        self._folder.cleanup()

    def _feed(self, popen: "subprocess.Popen[bytes]") -> None:
        """One job after another to one process, until it ends."""
        assert popen.stdin is not None and popen.stdout is not None
        done: Future[None] = Future()
        try:
            helper.send(popen.stdin, self._home)
            while True:
                _, _, job, done = self._jobs.get()
                if job is None:
                    return
                helper.send(popen.stdin, job)
                error = pickle.load(popen.stdout)
                done.set_exception(error) if error else done.set_result(None)
        except (OSError, EOFError):
            if not done.done():
                done.set_exception(GlhybridError("a process beside the study has ended"))
        finally:
            self._left -= 1


def serve() -> None:
    """What such a process does: makes what it is told, and answers each with an error or None."""
    answers = helper.answering()
    if (home := helper.receive()) is None:
        return
    with Renderer(device=home.device, keep_programs=True) as renderer:
        while (job := helper.receive()) is not None:
            error: Exception | None = None
            try:
                job.make(renderer, home)
            except Exception as raised:  # the study meets the same, and tells it
                error = GlhybridError(str(raised))
            if not helper.answer(answers, error):
                os._exit(1)
    sys.stdin.close()

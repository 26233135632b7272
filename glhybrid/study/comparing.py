"""Pictures are held against the truth in processes beside this one while the device makes the next: figures and files
of 1920x1080 pixels take a second of a core. On a software device, whose times that would disturb, here and at once.
"""

import os
import pickle
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from glhybrid import interrupts
from glhybrid.bvh.blas import threads_available
from glhybrid.errors import GlhybridError
from glhybrid.image import Frame
from glhybrid.study import helper
from glhybrid.study.measure import ErrorMaps, Truth, compared

HERE = 2  # threads of this process that work with NumPy
FREE = 2  # threads left to this process and the driver
BYTES_A_PIXEL = 400  # of memory, by the truth and pictures
COMMAND = "from glhybrid.study.comparing import serve; serve()"


def processes(size: tuple[int, int]) -> int:
    """How many may compare pictures of a size in pixels: a thread each, in half of the memory that is free."""
    try:
        free = os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (ValueError, OSError):
        free = 1 << 32
    room = free // 2 // (BYTES_A_PIXEL * size[0] * size[1] + (100 << 20))  # 100 MiB: Python and NumPy
    return int(max(min(threads_available() - FREE, room), 0))


class Comparing:
    """Compares with one truth. Close it, so that its processes end."""

    def __init__(self, truth: Truth, processes: int) -> None:
        """processes: 0 to do it here."""
        self._truth = truth
        self._free: SimpleQueue[_Process] = SimpleQueue()
        self._all: list[_Process] = []
        self._threads = ThreadPoolExecutor(processes) if processes else None
        self._here = ThreadPoolExecutor(HERE) if processes else None
        self._folders: set[Path] = set()
        try:
            with interrupts.deferred():
                self._all += [_Process(truth) for _ in range(processes)]
            for process in self._all:
                self._free.put(process)
        except BaseException:
            self.close()
            raise

    def submit(self, frame: Frame, maps: ErrorMaps, folder: Path, stem: str) -> "Future[dict[str, Any]]":
        """`compared` of the frame, now or later."""
        if self._threads is None:
            done: Future[dict[str, Any]] = Future()
            done.set_result(compared(frame, maps, self._truth, folder, stem))
            return done
        self._folders.add(folder)
        needed = Frame(frame.rgb, {name: frame[name] for name in ("radiance", "visibility")})
        job = needed, maps, folder, stem
        return self._threads.submit(self._ask, job)

    def call(self, work: Callable[..., dict[str, Any]], *args: Any) -> "Future[dict[str, Any]]":
        """NumPy's work, here: beside this thread where pictures are compared beside this process, else at once."""
        if self._here is not None:
            return self._here.submit(work, *args)
        done: Future[dict[str, Any]] = Future()
        done.set_result(work(*args))
        return done

    def _ask(self, job: Any) -> dict[str, Any]:
        process = self._free.get()
        try:
            return process.ask(job)
        finally:
            self._free.put(process)

    def close(self) -> None:
        """What is not finished is given up."""
        for process in self._all:
            process.kill()
        if self._threads is not None:
            self._threads.shutdown(cancel_futures=True)  # whoever still reads from one has met its end
        if self._here is not None:
            self._here.shutdown(cancel_futures=True)
        for process in self._all:
            process.close(self._folders)


class _Process:
    def __init__(self, truth: Truth) -> None:
        self._popen = helper.start(COMMAND, nice=5)
        self._truth: Truth | None = truth

    def ask(self, job: Any) -> dict[str, Any]:
        stdin, stdout = self._popen.stdin, self._popen.stdout
        assert stdin is not None and stdout is not None
        try:
            if self._truth is not None:
                helper.send(stdin, self._truth)
                self._truth = None
            helper.send(stdin, job)
            answer = pickle.load(stdout)
        except (OSError, EOFError):
            raise GlhybridError("a process that compares pictures has ended: out of memory?") from None
        if isinstance(answer, BaseException):
            raise answer
        return dict(answer)

    def kill(self) -> None:
        self._popen.kill()

    def close(self, folders: Iterable[Path]) -> None:
        """Once nobody asks it any more. folders: where it may have been writing."""
        self._popen.communicate()
        for folder in folders:
            for path in folder.glob(f".*.{self._popen.pid}.part*"):
                path.unlink(missing_ok=True)


def serve() -> None:
    """What such a process does: reads the truth, then pictures, and answers each."""
    answers = helper.answering()
    if (truth := helper.receive()) is None:
        return
    while (job := helper.receive()) is not None:
        try:
            answer: Any = compared(job[0], job[1], truth, *job[2:])
        except Exception as error:
            answer = error
        if not helper.answer(answers, answer):
            os._exit(1)

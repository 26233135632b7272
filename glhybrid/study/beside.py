"""What is not timed, made in processes beside this one: stability curves and cases of the failure library.

On a GPU most of their time is compilation, on one core. Each process has a context of its own and keeps what it makes
(store.py), where the study then finds it: nothing else passes between them, and what one could not make is made here.
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Any

MOST = 8  # processes: each compiles, and holds a context
COMMAND = "from glhybrid.study.beside import serve; serve()"
STABILITY, FAILURES = "stability", "failures"
LOOK_S = 0.2  # between two looks at the clock
STALL_S = 90.0  # without a job done, whatever keeps them: the rest is then made here
Job = tuple[str, str]  # part of a study, name of a curve or case


@contextmanager
def making(
    device: str, output: Path, quick: bool, jobs: Iterable[Job], processes: int
) -> Iterator[Callable[[Callable[[int], None]], None]]:
    """Makes the jobs in so many processes, the first ones first, until the end of the `with`.

    Gives a function that waits for them; what it is given is called now and then with how many are done.
    """
    waiting: SimpleQueue[Job] = SimpleQueue()
    for job in jobs:
        waiting.put(job)
    finished: SimpleQueue[Job | None] = SimpleQueue()  # None: a process has ended
    start = json.dumps({"device": device, "output": str(output), "quick": quick})
    running = [_start() for _ in range(processes)]
    threads = [Thread(target=_feed, args=(popen, start, waiting, finished), daemon=True) for popen in running]

    def wait(told: Callable[[int], None]) -> None:
        left, done, moved = processes, 0, time.monotonic()
        while left and time.monotonic() - moved < STALL_S:
            try:
                if finished.get(timeout=LOOK_S) is None:
                    left -= 1
                else:
                    done += 1
                moved = time.monotonic()
            except Empty:
                pass
            told(done)
        stop()  # whoever stands still is not to go on later

    def stop() -> None:
        for popen, thread in zip(running, threads, strict=True):
            popen.kill()
            thread.join()
            popen.communicate()  # closes its pipes

    for thread in threads:
        thread.start()
    try:
        yield wait
    finally:
        stop()


def _start() -> "subprocess.Popen[str]":
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    return subprocess.Popen(
        [sys.executable, "-c", COMMAND], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        text=True, env=environment, start_new_session=True,  # an interrupt is for us, who then end it
    )  # fmt: skip


def _feed(popen: "subprocess.Popen[str]", start: str, waiting: "SimpleQueue[Job]", finished: Any) -> None:
    """One job after another to one process, until there are none or it ends."""
    assert popen.stdin is not None and popen.stdout is not None
    try:
        print(start, file=popen.stdin, flush=True)
        while True:
            job = waiting.get_nowait()
            print(json.dumps(job), file=popen.stdin, flush=True)
            if not popen.stdout.readline():
                return
            finished.put(job)
    except (Empty, OSError):
        return
    finally:
        finished.put(None)


def serve() -> None:
    """What such a process does: makes what it is told, and answers a line for each."""
    from glhybrid.renderer import Renderer
    from glhybrid.study import curves, run
    from glhybrid.study.progress import Meter

    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what else is printed is no answer
    start, meter = json.loads(sys.stdin.readline()), Meter(None, lines=False)
    output = Path(start["output"])
    with Renderer(device=start["device"]) as renderer:
        for line in sys.stdin:
            part, name = json.loads(line)
            if part == STABILITY:
                curves.make(renderer, name, output / part, start["quick"], meter, lambda _: None)
            else:
                run.failures(renderer, output / part, meter, lambda _: None, [name])
            print(name, file=answers, flush=True)

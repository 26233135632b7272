"""Processes that a study starts and talks to by pickles over pipes.

They are started as commands, not by multiprocessing, which would run a caller's script again; in sessions of their own,
so that an interrupt is the study's alone, who then ends them; and they end with it, however it ends.
"""

import contextlib
import ctypes
import os
import pickle
import signal
import subprocess
import sys
from pathlib import Path
from typing import IO, Any

_PR_SET_PDEATHSIG = 1
# Cores are shared out among processes: threads of OpenMP (FLIP's) and of NumPy's BLAS spin where they wait, which takes
# the cores of the others.
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")


def start(command: str, nice: int = 0, **environment: str) -> "subprocess.Popen[bytes]":
    """A Python process of one thread that runs a command. nice: how much it yields to others."""
    variables = os.environ | ONE_THREAD | environment | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    prelude = f"from glhybrid.study import helper; helper.begin({os.getpid()}, {nice}); "
    return subprocess.Popen(
        [sys.executable, "-c", prelude + command], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        stderr=None if os.environ.get("GLHYBRID_DEBUG") else subprocess.DEVNULL,  # whoever asks is told by an answer
        env=variables, start_new_session=True,
    )  # fmt: skip


def begin(parent: int, nice: int) -> None:
    """The first thing such a process does."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)  # Linux: it may be standing still when we go
    if os.getppid() != parent:
        os._exit(1)
    os.nice(nice)


def stands(process: "subprocess.Popen[bytes]") -> bool:
    """Whether it stands still, or has ended; False where that is not told."""
    try:
        return Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()[0] in "TtZ"
    except OSError:
        return process.poll() is not None


def answering() -> IO[bytes]:
    """Where answers go; what else the process prints is none."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    return answers


def send(stream: IO[bytes], value: Any) -> None:
    """To the other end, at once."""
    pickle.dump(value, stream, pickle.HIGHEST_PROTOCOL)
    stream.flush()


def receive() -> Any:
    """What the study says next; None once it has gone, or has been stopped in the midst of it."""
    try:
        return pickle.load(sys.stdin.buffer)
    except (EOFError, pickle.UnpicklingError):
        return None


def answer(stream: IO[bytes], value: Any) -> bool:
    """Whether there is still somebody who listens."""
    try:
        send(stream, value)
    except BrokenPipeError:
        return False
    return True

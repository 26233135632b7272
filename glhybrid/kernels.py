"""Kernels that are compiled together, what is done while they are not, and the process that compiles them beside.

Numba compiles for seconds at a first run ever, and takes most of one to be loaded at any other. So small work is done
without it: trees by sweep.py, poses by the same functions as plain Python. What that has taken is added up, and once it
is as much as the kernels cost to have, they are loaded: never more than twice the better choice, seen from the end.

Where they have never been compiled, another process compiles them for the next run: detached, as this one may end
first; last in line for processors and first to go where memory runs out; never two at once, and not where nothing could
be kept. Numba renames whole files into its folder, so that one that is killed half-way leaves none that is damaged.
Chosen over a thread, which would hold the interpreter's lock for most of it and could not outlive a short run; torch's
and others' compilers keep processes too. GLHYBRID_COMPILE says what users want: `aside`; `first`, compile and wait, as
tests and benches do, whose trees are to be the same in every run; `never`, start no process.
"""

import contextlib
import hashlib
import importlib
import logging
import os
import platform
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np

from glhybrid import jit
from glhybrid.errors import SettingError, unknown

log = logging.getLogger("glhybrid")
MODES = ("aside", "first", "never")
QUICK = (
    "trees by the quick builder, the better one not having been compiled: rays pass those of later runs in up to 30 % "
    "fewer steps"
)
LOADING_S = 0.7  # of Numba, and of kernels that are kept
LOOK_S = 0.05  # of work, after which it is thought over again whether to load them
LONGEST_S = 900  # of a process beside
# Of arrays, as Numba has them: read-only ones by a letter and the number of dimensions.
_READ_ONLY = {"f1": ("float64", 1), "f2": ("float64", 2), "f3": ("float64", 3), "i1": ("int64", 1), "b1": ("uint8", 1),
              "u1": ("uint32", 1), "u2": ("uint32", 2)}  # fmt: skip


def mode() -> str:
    """GLHYBRID_COMPILE. Raises SettingError for what it cannot be."""
    asked = os.environ.get("GLHYBRID_COMPILE") or "aside"
    if asked not in MODES:
        raise SettingError(f"GLHYBRID_COMPILE: {unknown('way', asked, MODES)}")
    return asked


class Kernels:
    """A set of them. name: an attribute of this module; what: they are for; modules: that hold them; compiling_s: at a
    first run.

    loaded: compiled, and in this process. spent: seconds of work without them.
    """

    def __init__(self, name: str, what: str, modules: tuple[str, ...], compiling_s: float) -> None:
        self.name, self.loaded, self.spent = name, False, 0.0
        self._what, self._modules, self._compiling_s = what, modules, compiling_s
        self._lock = threading.RLock()
        self._ready = self._started = self._loading = self._alone = False
        self._process: subprocess.Popen[bytes] | None = None  # that compiles them
        self._look = 0.0
        self._kernels: list[_Kernel] = []
        self._helpers: set[Any] = set()

    def kernel(self, signature: str) -> Callable[[Any], "_Kernel"]:
        """Like jit.kernel, for a function that also runs as it stands. signature: as Numba reads it, and _READ_ONLY.

        It is to give the same bits: no powers (products), sines by `math`, counts by int().
        """

        def declare(function: Any) -> _Kernel:
            self._kernels.append(_Kernel(self, function, signature))
            return self._kernels[-1]

        return declare

    def helper(self, function: Any) -> Any:
        """For functions that kernels of the same module call."""
        self._helpers.add(function)
        return function

    def ready(self) -> bool:
        """Whether they are compiled: in this process, or on the disk for this source, Numba, Python and processor."""
        if not (self.loaded or self._ready):
            mark = self._mark()
            self._ready = mark is not None and mark.is_file()
        return self.loaded or self._ready

    def load(self) -> None:
        """Compiles them or takes them from the disk; says so there."""
        with self._lock:
            if self.loaded:
                return
            for module in self._modules:
                importlib.import_module(module)
            for kernel in self._kernels:
                kernel.compile()
            self.loaded = True
            mark = self._mark()
            if mark is not None and not self._ready and not jit.refused():
                with contextlib.suppress(OSError):
                    mark.touch()

    def pay(self, seconds: float = 0.0, better: bool = False) -> bool:
        """Whether to load them for work that takes so many seconds without; else these are spent.

        better: so is what they make, and they are loaded wherever they are compiled.
        """
        if self.loaded or self._alone:
            return self.loaded
        asked, ready = mode(), self.ready()
        price = LOADING_S if ready else self._compiling_s
        under_way = not ready and self._process is not None and self._process.poll() is None
        dear = self.spent + seconds > price and (better or not under_way)
        if asked == "first" or (ready and better) or dear:
            return True
        self.spent += seconds
        if not ready and asked == "aside" and (better or self.spent > LOADING_S):
            self._compile_aside()
        return False

    @contextlib.contextmanager
    def left_alone(self) -> Iterator[None]:
        """Within it nothing is loaded, compiled or spent."""
        before, self._alone = self._alone, True
        try:
            yield
        finally:
            self._alone = before

    def due(self) -> bool:
        """The same, for work that adds up in small pieces, such as frames that are not to wait in between: what is kept
        is loaded by a thread, and work goes on without until it is there."""
        if self.spent < self._look:
            return False
        self._look = self.spent + LOOK_S
        if not self.pay():
            return False
        if mode() == "first" or not self.ready():
            return True
        if not self._loading:  # no daemon: that could be stopped inside LLVM as the process ends
            self._loading = True
            threading.Thread(target=self.load, name="glhybrid: loading").start()
        return False

    def _compile_aside(self) -> None:
        if self._started:
            return
        self._started = True
        folder = jit.folder()
        if os.name != "posix" or folder is None or not jit.writable(folder) or not _is_python():
            return
        with contextlib.suppress(OSError):
            with locked(folder) as lock:  # which the other process has from its beginning to its end
                self._process = _start(f"from glhybrid import kernels; kernels.compile_beside('{self.name}')", lock)
            log.info("kernels are compiled in a process beside, for %s from the next run on", self._what)

    def _mark(self) -> Path | None:
        """The file that says they are compiled. Numba itself looks at the time and size of a source file."""
        folder = jit.folder()
        if folder is None:
            return None
        package = Path(__file__).parent
        states = [
            (str(file), (state := file.stat()).st_mtime_ns, state.st_size)
            for file in (package.joinpath(*name.split(".")[1:]).with_suffix(".py") for name in self._modules)
        ]
        about = repr((states, _machine())).encode()
        return folder / f"{self.name}-{hashlib.sha256(about).hexdigest()[:16]}.ready"


class _Kernel:
    """A function that runs as plain Python until its set is loaded."""

    def __init__(self, kernels: Kernels, function: Any, signature: str) -> None:
        self._set, self._signature, self.plain = kernels, signature, function
        self._compiled: Any = None

    def __call__(self, *args: Any) -> Any:
        if self._compiled is None:
            if not self._set.due():
                return self._run(*args)
            self._set.load()
        return self._compiled(*args)

    def _run(self, *args: Any) -> Any:
        started = time.perf_counter()
        with np.errstate(all="ignore"):  # as compiled code
            result = self.plain(*args)
        self._set.spent += time.perf_counter() - started
        return result

    def compile(self) -> None:
        """Or take it from the disk."""
        from numba import njit, types

        names = vars(types) | {
            name: types.Array(getattr(types, item), dimensions, "C", readonly=True)
            for name, (item, dimensions) in _READ_ONLY.items()
        }

        def with_helpers(function: Any) -> Any:
            around = dict(function.__globals__)
            for name in function.__code__.co_names:
                if isinstance(helper := around.get(name), FunctionType) and helper in self._set._helpers:
                    around[name] = njit(with_helpers(helper))
            return FunctionType(function.__code__, around, function.__name__)

        self._compiled = jit.kernel(eval(self._signature, names))(with_helpers(self.plain))


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[int]:
    """A descriptor: whoever holds it, or a copy, compiles into the folder. Raises OSError if somebody else does."""
    import fcntl

    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield descriptor
    finally:
        os.close(descriptor)


def compile_beside(*names: str) -> None:
    """What the process beside does."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(LONGEST_S)
    with contextlib.suppress(OSError):
        os.nice(19)
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000")
    for name in names:
        kernels: Kernels = globals()[name]
        if not kernels.ready():
            kernels.load()


def _start(command: str, lock: int) -> "subprocess.Popen[bytes]":
    path = os.pathsep.join(dict.fromkeys(os.path.abspath(p) for p in sys.path))
    process = subprocess.Popen(
        [sys.executable, "-P", "-c", command], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
        stderr=None if os.environ.get("GLHYBRID_DEBUG") else subprocess.DEVNULL,
        env=os.environ | {"PYTHONPATH": path}, start_new_session=True, pass_fds=(lock,),
    )  # fmt: skip
    threading.Thread(target=process.wait, daemon=True, name="glhybrid: kernels").start()  # nobody else will
    return process


def _is_python() -> bool:
    """Whether there is an interpreter to start: an application that has Python in it may name itself."""
    return Path(sys.executable or "").name.lower().startswith(("python", "pypy")) and not hasattr(sys, "frozen")


@cache
def _machine() -> tuple[str, ...]:
    """What compiled code depends on, besides its source."""
    first: list[str] = []
    with contextlib.suppress(OSError), open("/proc/cpuinfo", "rb", buffering=0) as file:
        first = file.read(4096).decode(errors="replace").split("\n\n")[0].splitlines()  # of all, some take long
    told = [line for line in first if line.startswith(("model name", "flags", "Features", "CPU "))]
    found = [sys.version, platform.machine(), *told]
    for package in ("numba", "llvmlite"):
        spec = find_spec(package)  # importlib.metadata would take 20 ms
        with contextlib.suppress(OSError):
            found.append(Path(str(spec and spec.origin)).with_name("_version.py").read_text())
    return tuple(found)


def load_all() -> None:
    """For whoever measures: the same trees and times in every run."""
    for kernels in (TREES, MOTION):
        kernels.load()


_BVH = "glhybrid.bvh"
TREES = Kernels(
    "TREES",
    "trees that rays pass in fewer steps",
    tuple(f"{_BVH}.{name}" for name in ("boxes", "leaves", "build", "reinsert")),
    5.0,
)
MOTION = Kernels("MOTION", "faster motion", ("glhybrid.swarm", f"{_BVH}.top"), 6.0)

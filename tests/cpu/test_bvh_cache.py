"""Trees and compiled kernels on the disk: the same ones come back, damage and full disks stop nothing."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bvh_shapes import Triangles, same, soup
from numba import njit
from numba.core.dispatcher import Dispatcher

from glhybrid import bvh
from glhybrid.bvh import Blas, cache, load_or_build

ROOT = Path(__file__).resolve().parents[2]


def test_warm_up_compiles_once(monkeypatch: pytest.MonkeyPatch) -> None:
    assert bvh.warm_up() >= 0
    compiled = []
    monkeypatch.setattr(Dispatcher, "compile", lambda self, signature: compiled.append((self, signature)))
    bvh.warm_up()
    assert not compiled
    njit(lambda x: x)._compile_for_args(1)  # what would have been counted
    assert compiled


@pytest.fixture
def kept(tmp_path: Path) -> tuple[Triangles, Blas, Path]:
    triangles = soup(3000, 21)
    tree = load_or_build(triangles, folder=tmp_path)
    (path,) = tmp_path.glob("*.blas")
    return triangles, tree, path


def test_cache_gives_the_same_tree(kept: tuple[Triangles, Blas, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    triangles, tree, path = kept
    monkeypatch.setattr(cache, "build_blas", lambda *_, **__: pytest.fail("built again"))
    again = load_or_build(triangles, folder=path.parent)
    assert same(tree, again)
    assert again.bounds.dtype == np.float64 and again.grid_min.dtype == np.float32
    again.validate()


def test_cache_tells_inputs_apart(kept: tuple[Triangles, Blas, Path]) -> None:
    triangles, tree, path = kept
    moved = triangles.copy()
    moved[1234, 1, 2] = np.nextafter(moved[1234, 1, 2], np.float32(9))
    geometry = np.zeros(3000, np.uint32)
    geometry[5] = 1
    for other in (
        load_or_build(moved, folder=path.parent),
        load_or_build(triangles, geometry=geometry, folder=path.parent),
        load_or_build(triangles, max_leaf=2, folder=path.parent),
        load_or_build(triangles, reinsert=False, folder=path.parent),
        load_or_build(triangles, spheres=np.array([[0, 0, 0, 1]], np.float32), folder=path.parent),
    ):
        assert not same(tree, other)
    assert len(list(path.parent.glob("*.blas"))) == 6


@pytest.mark.parametrize("damage", ["empty", "cut", "longer", "header", "node", "slot", "foreign", "other key", "old"])
def test_damaged_files_are_rebuilt(damage: str, kept: tuple[Triangles, Blas, Path]) -> None:
    triangles, tree, path = kept
    data = bytearray(path.read_bytes())
    if damage == "empty":
        data.clear()
    elif damage == "cut":
        del data[-1000:]
    elif damage == "longer":
        data += bytes(4)
    elif damage == "foreign":
        data[:] = b"\x93NUMPY" + bytes(len(data) - 6)
    elif damage == "old":
        data[:] = data.replace(b'"version": ', b'"version": 9')
    elif damage == "other key":
        load_or_build(triangles, max_leaf=2, folder=path.parent)
        (other,) = set(path.parent.glob("*.blas")) - {path}
        data[:] = other.read_bytes()
    else:
        data[{"header": 40, "node": -48 * 3000 - 400, "slot": -500}[damage]] ^= 0x10
    path.write_bytes(data)
    assert cache.read(path, path.stem, 0.0) is None
    assert same(tree, load_or_build(triangles, folder=path.parent))
    assert cache.read(path, path.stem, 0.0) is not None  # and is whole again


def test_a_check_sees_what_happens_to_files() -> None:
    """Bits that flip, words, pages and rows that are zeroed, moved or exchanged; of any length, odd tails included."""
    rng = np.random.default_rng(4)
    for size in (0, 5, 8, 4096, 8192, 3 * 8192 + 13, 5 << 18):
        data = rng.integers(0, 256, size, dtype=np.uint8)
        want, seen = cache.check(memoryview(data)), {cache.check(memoryview(data))}
        assert cache.check(memoryview(bytes(size))) != want or size == 0
        for _ in range(40 if size else 0):
            bad, kind = data.copy(), rng.integers(4)
            at, length = int(rng.integers(size)), int(rng.integers(1, min(size, 8192) + 1))
            if kind == 0:
                bad[at] ^= 1 << rng.integers(8)
            elif kind == 1:
                bad[at : at + length] = 0
            elif kind == 2:
                bad = np.roll(bad, length)
            else:
                other = int(rng.integers(size))
                bad[at], bad[other] = data[other], data[at]
            assert (cache.check(memoryview(bad)) == want) == np.array_equal(bad, data)
            seen.add(cache.check(memoryview(bad)))
        assert len(seen) > 20 or size < 4096
    words = np.zeros(1 << 17, np.uint64)  # sums that cancel in columns are told by rows, and the other way round
    words[[5, 1024 + 5]] = 1, 2
    swapped = words.copy()
    swapped[[5, 1024 + 5]] = 2, 1
    moved = np.roll(words, 1)
    assert len({cache.check(w.data.cast("B")) for w in (words, swapped, moved)}) == 3


def test_runs_tell_arrays_apart() -> None:
    """What the key holds instead of the numbers gives the numbers back."""
    made: list[Any] = [np.arange(9), np.zeros(9), np.r_[np.zeros(4), np.ones(5)], np.r_[np.arange(4), np.arange(7, 12)]]
    made += [np.r_[3, 3, 4], np.r_[0, 2**32 - 1, 0], np.r_[7]]
    for numbers in (array.astype(np.uint32) for array in made):
        told = cache._runs(numbers)
        assert told is not None
        step, first, ends = int(told[0]), told[1], np.split(told[2:].astype(np.int64), 2)
        back = np.full(len(numbers), step, np.int64)
        back[0] = first
        for at, value in zip(*ends, strict=True):
            back[at] = value - back[:at].sum()
        np.testing.assert_array_equal(np.cumsum(back).astype(np.uint32), numbers)
    assert cache._runs(np.random.default_rng(0).integers(0, 2**32, 20_000).astype(np.uint32)) is None


def test_cache_folder_that_cannot_be_used_is_no_error(tmp_path: Path, kept: tuple[Triangles, Blas, Path]) -> None:
    triangles, tree, _ = kept
    (tmp_path / "file").write_text("not a folder")
    assert same(tree, load_or_build(triangles, folder=tmp_path / "file"))
    assert same(tree, load_or_build(triangles, folder=Path("/proc/nowhere")))


def test_cache_is_bounded(tmp_path: Path) -> None:
    import os

    for i in range(5):
        (tmp_path / f"{i}.blas").write_bytes(bytes(100))
        os.utime(tmp_path / f"{i}.blas", (i, i))
    (tmp_path / "dead.part").write_bytes(b"")
    os.utime(tmp_path / "dead.part", (0, 0))
    (tmp_path / "notes.txt").write_text("not ours")
    cache.trim(tmp_path / "0.blas", limit=300)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["0.blas", "3.blas", "4.blas", "notes.txt"]


def test_nothing_is_written_where_the_cache_is_off(tmp_path: Path) -> None:
    """Not even compiled kernels, and no folder called "off"."""
    script = tmp_path / "kernel.py"
    script.write_text(
        "from numba import types\nfrom glhybrid.jit import kernel\n\n"
        "@kernel(types.int64(types.int64))\ndef f(x):\n    return x + 1\n\nassert f(1) == 2\n"
    )
    kept = {"GLHYBRID_CACHE": "off", "PYTHONPATH": str(ROOT), "PATH": os.environ["PATH"], "HOME": str(tmp_path)}
    subprocess.run([sys.executable, script], cwd=tmp_path, env=kept, check=True, timeout=300)
    assert list(tmp_path.iterdir()) == [script]


def test_a_kernel_is_compiled_anew_when_what_it_borrows_changes(tmp_path: Path) -> None:
    """Numba itself looks at the kernel's own file only."""
    (tmp_path / "kernel.py").write_text(
        "import sys\nfrom numba import types\nfrom borrowed import add\nfrom glhybrid.jit import kernel\n\n"
        "@kernel(types.int64(types.int64))\ndef f(x):\n    return add(x)\n\n"
        "print(f(1), sum(f.stats.cache_hits.values()))\n"
    )
    folders = {"GLHYBRID_CACHE": str(tmp_path / "cache"), "PYTHONPATH": str(ROOT), "PATH": os.environ["PATH"]}
    said = []
    for more in (1, 1, 2):
        (tmp_path / "borrowed.py").write_text(f"from numba import njit\n\n@njit\ndef add(x):\n    return x + {more}\n")
        run = [sys.executable, "-B", tmp_path / "kernel.py"]
        done = subprocess.run(run, env=folders, check=True, timeout=300, capture_output=True, text=True)
        said.append(done.stdout.split())
    assert said == [["2", "0"], ["2", "1"], ["3", "0"]]


def test_the_first_compilation_is_said_and_no_other(tmp_path: Path) -> None:
    script = tmp_path / "kernels.py"
    script.write_text(
        "import logging\nfrom numba import types\nfrom glhybrid.jit import kernel\nlogging.basicConfig(level='INFO')\n"
        "@kernel(types.int64(types.int64))\ndef f(x):\n    return x + 1\n"
        "@kernel(types.int64(types.int64))\ndef g(x):\n    return x + 2\n"
    )
    for cache_folder, said in ((str(tmp_path / "kept"), 1), (str(tmp_path / "kept"), 0), ("off", 1)):
        kept = {"GLHYBRID_CACHE": cache_folder, "PYTHONPATH": str(ROOT), "PATH": os.environ["PATH"]}
        done = subprocess.run(
            [sys.executable, script], env=kept, check=True, timeout=300, capture_output=True, text=True
        )
        assert done.stderr.count("compiling the kernels") == said, done.stderr


def test_a_full_disk_keeps_nothing_and_stops_nothing(tmp_path: Path) -> None:
    script = tmp_path / "kernel.py"
    script.write_text(
        "import resource, signal\nfrom numba import types\nfrom glhybrid.jit import kernel\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\nresource.setrlimit(resource.RLIMIT_FSIZE, (64, 64))\n"
        "@kernel(types.int64(types.int64))\ndef f(x):\n    return x + 1\n\nassert f(1) == 2\n"
        "@kernel(types.int64(types.int64))\ndef g(x):\n    return x + 2\n\nassert g(1) == 3\n"
    )
    kept = {"GLHYBRID_CACHE": str(tmp_path / "kept"), "PYTHONPATH": str(ROOT), "PATH": os.environ["PATH"]}
    done = subprocess.run([sys.executable, script], env=kept, check=True, timeout=300, capture_output=True, text=True)
    assert done.stderr.count("cannot be kept: File too large") == 1, done.stderr


def test_cache_can_be_turned_off(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GLHYBRID_CACHE", "off")
    monkeypatch.setattr(cache, "write", lambda *_: pytest.fail("kept"))
    load_or_build(soup(2000, 1))
    monkeypatch.undo()
    monkeypatch.setenv("GLHYBRID_CACHE", str(tmp_path))
    load_or_build(soup(2000, 1))
    assert list((tmp_path / "bvh").glob("*.blas"))

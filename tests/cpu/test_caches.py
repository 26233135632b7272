"""What is kept on disk is told by kind, bounded, and deleted when asked; references are kept small."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from glhybrid import caches, content_cache
from glhybrid.cli import main
from glhybrid.errors import SettingError
from glhybrid.study import reference
from glhybrid.study.packing import BITS, pack, unpack


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache folder with something of three kinds, beside what is not ours."""
    monkeypatch.setenv("GLHYBRID_CACHE", str(tmp_path))
    content_cache.write("sky", "a", bytes(1000))
    for name, size in (("reference/k.npz", 3000), ("numba/3f/x.nbc", 500), ("bvh/t.blas", 70), ("bvh/t.txt", 9)):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(bytes(size))
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "cat.sky").write_bytes(b"mine")
    return tmp_path


def test_what_is_kept_is_told(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = {one.kind: one for one in caches.look()}
    assert found.keys() >= {"bake", "bvh", "numba", "probe", "program", "reference", "sky", "tuning", "unwrap"}
    sizes = {kind: one.bytes for kind, one in found.items() if one.files}
    assert sizes == {"bvh": 70, "numba": 500, "reference": 3000, "sky": 1000 + content_cache.DIGEST}
    assert all(one.what and (one.limit or one.kind == "numba") for one in found.values())
    assert main(["cache", "reference", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["folder"] == str(folder) and told["freed"] == 0
    assert [(k["kind"], k["bytes"], k["limit"]) for k in told["kinds"]] == [
        ("reference", 3000, caches.REFERENCES_BYTES)
    ]
    assert main(["cache"]) == 0
    assert "all" in capsys.readouterr().out


def test_only_ours_is_deleted(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["cache", "bvh", "--clear"]) == 0
    assert [one.kind for one in caches.look() if one.files] == ["numba", "reference", "sky"]
    assert caches.clear() == 4500 + content_cache.DIGEST
    left = sorted(str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file())
    assert left == ["bvh/t.txt", "photos/cat.sky"]
    assert main(["cache", "--clear", "--json"]) == 0  # nothing is no error
    capsys.readouterr()


def test_what_there_is_not_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SettingError, match='"photos"; there are bake, bvh'):
        caches.clear("photos")
    assert main(["cache", "photos", "--clear"]) == 2
    monkeypatch.setenv("GLHYBRID_CACHE", "off")
    with pytest.raises(SettingError, match="GLHYBRID_CACHE=off"):
        caches.look()


def pictures() -> np.ndarray:
    """Noise of twelve orders of magnitude, black pixels, a speck in one of eight."""
    rng = np.random.default_rng(0)
    made = rng.lognormal(0, 3, (8, 40, 30, 1)) * rng.uniform(0, 1, (8, 40, 30, 3)) * (rng.random((8, 40, 30, 1)) > 0.1)
    made[3, 5, 5] = 1e30
    made[:, 6, 6] = 0
    made[:, 7, 7] = (1, 0, 1e-9)
    made[:, 8, 8] = (511.4 / 512, 511.6 / 512, 0.9999)  # rounds up to the next exponent
    return made.astype(np.float32)


def test_pictures_in_a_third_of_the_room() -> None:
    """Off by half a step of nine bits at most, 1/512 of the pixel's largest channel; a mean of equal parts by less."""
    given = pictures()
    words, scale = pack(given)
    got = unpack(words, scale)
    assert words.nbytes + scale.nbytes <= given.nbytes / 12 * (4 + 2 / len(given))
    largest = given.max(-1, keepdims=True)
    off = np.abs(got - given) / np.maximum(largest, 1e-30)
    seen = largest[..., 0] >= 2.0**-31 * largest[..., 0].max(0)
    assert 0.3 / 2**BITS < off[seen].max() <= 1.001 / 2**BITS
    assert (got[~seen] <= 2 * given[~seen]).all(), "too dark beside the speck"
    assert (got[:, 6, 6] == 0).all() and got[3, 5, 5] == pytest.approx(1e30, rel=1e-3)
    again = pack(got)
    assert np.array_equal(again[0], words) and np.array_equal(again[1], scale), "what was packed stays as it is"
    equal = np.random.default_rng(1).uniform(0.5, 1.5, (16, 64, 64, 3)).astype(np.float32)
    mean = unpack(*pack(equal)).mean(0) / equal.mean(0) - 1
    assert np.sqrt((mean**2).mean()) < 4e-4 and abs(mean.mean()) < 2e-5


@pytest.mark.parametrize("value", [-1e-3, np.nan, np.inf])
def test_what_is_no_radiance_is_not_packed(value: float) -> None:
    given = pictures()
    given[2, 3, 4, 1] = value
    with pytest.raises(ValueError, match="negative or not finite"):
        pack(given)


def test_references_make_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those used longest ago go first; and what goes on from one is what a run that did not stop has."""
    sums = np.concatenate([pictures(), pictures()])
    size = (sums.shape[2], sums.shape[1])
    monkeypatch.setattr(reference, "REFERENCES_BYTES", int(2.5 * 65 * size[0] * size[1]))
    for age, name in ((3, "a"), (2, "b")):
        reference._Parts(sums, 8, 16, 1.5).write(tmp_path / f"{name}.npz")
        os.utime(tmp_path / f"{name}.npz", (1e9 - age, 1e9 - age))
    read = reference._Parts.read(tmp_path / "a.npz", size)  # and is now the newest
    assert (read.count, read.batches, read.seconds) == (8, 16, 1.5)
    parts = reference._Parts(sums, 8, 16, 1.5)
    parts.write(tmp_path / "c.npz")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.npz", "c.npz"]
    assert np.array_equal(parts.sums, read.sums) and np.array_equal(parts.pictures()[0], read.pictures()[0])

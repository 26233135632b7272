"""What is kept on disk comes back whole or not at all."""

from pathlib import Path

import pytest

from glhybrid import content_cache


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("GLHYBRID_CACHE", str(tmp_path))
    return tmp_path


def test_kept_texels_come_back() -> None:
    content_cache.write("sky", "a", b"texels")
    assert content_cache.read("sky", "a", 6) == b"texels"
    assert content_cache.read("sky", "b", 6) is None and content_cache.read("sky", "a", 7) is None


@pytest.mark.parametrize(
    "damage", [lambda b: b[:-1], lambda b: b[:25] + b"x" + b[26:], lambda _: b"", lambda b: b + b"x"]
)
def test_a_damaged_file_is_not_trusted(folder: Path, damage) -> None:  # type: ignore[no-untyped-def]
    content_cache.write("sky", "a", b"texels of a sky")
    file = folder / "sky" / "a.sky"
    file.write_bytes(damage(file.read_bytes()))
    assert content_cache.read("sky", "a", 15) is None


def test_keys_depend_on_where_parts_end() -> None:
    assert content_cache.key(b"ab", b"c") != content_cache.key(b"a", b"bc")


def test_a_folder_that_cannot_be_written_is_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GLHYBRID_CACHE", "/proc/nowhere")
    content_cache.write("sky", "a", b"texels")
    assert content_cache.read("sky", "a", 6) is None


def test_the_oldest_make_room(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import os

    monkeypatch.setitem(content_cache.LIMIT_BYTES, "sky", 250)
    for age, name in ((3, "a"), (2, "b")):
        content_cache.write("sky", name, bytes(80))
        os.utime(folder / "sky" / f"{name}.sky", (1e9 - age, 1e9 - age))
    assert content_cache.read("sky", "a") is not None  # and is now the newest
    content_cache.write("sky", "c", bytes(80))
    assert [content_cache.read("sky", n) is not None for n in "abc"] == [True, False, True]

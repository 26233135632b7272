"""What is kept on disk comes back whole or not at all."""

from pathlib import Path

import pytest

from glhybrid import sky_cache


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("GLHYBRID_CACHE", str(tmp_path))
    return tmp_path


def test_kept_texels_come_back() -> None:
    sky_cache.write("a", b"texels")
    assert sky_cache.read("a", 6) == b"texels"
    assert sky_cache.read("b", 6) is None and sky_cache.read("a", 7) is None


@pytest.mark.parametrize(
    "damage", [lambda b: b[:-1], lambda b: b[:25] + b"x" + b[26:], lambda _: b"", lambda b: b + b"x"]
)
def test_a_damaged_file_is_not_trusted(folder: Path, damage) -> None:  # type: ignore[no-untyped-def]
    sky_cache.write("a", b"texels of a sky")
    file = folder / "sky" / "a.sky"
    file.write_bytes(damage(file.read_bytes()))
    assert sky_cache.read("a", 15) is None


def test_keys_depend_on_where_parts_end() -> None:
    assert sky_cache.key(b"ab", b"c") != sky_cache.key(b"a", b"bc")


def test_a_folder_that_cannot_be_written_is_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GLHYBRID_CACHE", "/proc/nowhere")
    sky_cache.write("a", b"texels")
    assert sky_cache.read("a", 6) is None

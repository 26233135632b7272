"""The package as others get it: a wheel, installed outside the checkout, renders with its own shaders and scenes."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


def _run(*command: object, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(c) for c in command], cwd=cwd, env=os.environ | environment, capture_output=True, text=True, check=False
    )


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel built from the source distribution, as pip builds it when there is no wheel."""
    pytest.importorskip("build", reason="the package `build` is missing: pip install -e .[dev]")
    pytest.importorskip("hatchling", reason="the package `hatchling` is missing: pip install -e .[dev]")
    out = tmp_path_factory.mktemp("dist")
    done = _run(sys.executable, "-m", "build", "--no-isolation", "--outdir", out, ROOT, cwd=out)
    assert done.returncode == 0, done.stdout + done.stderr
    (found,) = out.glob("*.whl")
    return found


def test_the_wheel_is_pure_python_and_carries_every_shader_and_scene(wheel: Path) -> None:
    assert wheel.name.endswith("-py3-none-any.whl")
    names = set(zipfile.ZipFile(wheel).namelist())
    assert "glhybrid/py.typed" in names
    for kind in ("glsl", "scenes"):
        files = [p.relative_to(ROOT / kind) for p in (ROOT / kind).rglob("*") if p.is_file()]
        assert files
        missing = [str(f) for f in files if f"glhybrid/data/{kind}/{f.as_posix()}" not in names]
        assert not missing, missing
    assert not [n for n in names if n.startswith(("tests/", "shared/"))]


def test_an_installed_wheel_renders_outside_the_checkout(wheel: Path, tmp_path: Path) -> None:
    site = tmp_path / "site"
    pip = _run(
        sys.executable,
        "-m",
        "pip",
        "install",
        "--quiet",
        "--no-deps",
        "--no-index",
        "--target",
        site,
        wheel,
        cwd=tmp_path,
    )
    assert pip.returncode == 0, pip.stderr
    # Its own folder comes first, so that an editable install of the checkout has no say.
    where = _run(sys.executable, "-c", "import glhybrid; print(glhybrid.__file__)", cwd=tmp_path, PYTHONPATH=str(site))
    assert where.stdout.startswith(str(site)), where.stdout + where.stderr
    done = _run(
        sys.executable, site / "bin" / "glhybrid", "render", "cornell", "--size", "96x54", "--aa", "1", "-o", "a.png",
        cwd=tmp_path, PYTHONPATH=str(site), GLHYBRID_CACHE=str(tmp_path / "cache"),
    )  # fmt: skip
    if done.returncode == 3 and os.environ.get("GLHYBRID_REQUIRE_GL") != "1":
        pytest.skip(f"no OpenGL 4.3: {done.stderr}")
    assert done.returncode == 0, done.stdout + done.stderr
    np = pytest.importorskip("numpy")
    from PIL import Image

    with Image.open(tmp_path / "a.png") as picture:
        pixels = np.asarray(picture)
    assert pixels.shape == (54, 96, 3) and pixels.std() > 5  # a picture, not one colour

"""Where the files that travel with the package are: shaders and built-in scenes, in a checkout and in a wheel alike."""

import tomllib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Literal

from glhybrid.errors import GlhybridError


@dataclass(frozen=True)
class BuiltinScene:
    """One of those that come with the package. name: as load() takes it."""

    name: str
    description: str  # one line
    path: Path


@lru_cache(maxsize=4)
def data_folder(kind: Literal["glsl", "scenes"]) -> Path:
    """The folder of shaders or scenes: inside an installed wheel, else beside the package in a checkout."""
    package = Path(__file__).resolve().parent.parent
    for folder in (package / "data" / kind, package.parent / kind):
        if folder.is_dir():
            return folder
    raise GlhybridError(f"{package}: the folder {kind}/ is missing beside the package; reinstall glhybrid")


def scenes() -> list[BuiltinScene]:
    """The built-in scenes by name, for `glhybrid scenes`: every TOML in scenes/ that has a `description`.

    Scenes without a description are there for tests; they load by name as well.
    """
    found = []
    for path in sorted(data_folder("scenes").glob("*.toml")):
        description = tomllib.loads(path.read_text(encoding="utf-8")).get("description")
        if isinstance(description, str) and description:
            found.append(BuiltinScene(path.stem, description, path))
    return found


def failures() -> list[BuiltinScene]:
    """The failure library, by name (`failures/NAME`), described by the titles of its [study] tables."""
    found = []
    for path in sorted((data_folder("scenes") / "failures").glob("*.toml")):
        study = tomllib.loads(path.read_text(encoding="utf-8")).get("study", {})
        found.append(BuiltinScene(f"failures/{path.stem}", str(study.get("title", "")), path))
    return found


def scene_path(name: str) -> Path | None:
    """The file of a built-in scene, None if there is none of that name."""
    if not name.removeprefix("failures/").replace("-", "").replace("_", "").isalnum():
        return None  # a path, not a name: must not leave the folder
    if len(name) > 200:
        return None  # no file system has such a name
    path = data_folder("scenes") / f"{name}.toml"
    return path if path.is_file() else None


def scene_names() -> list[str]:
    """All names that load() takes, those of failures included."""
    folder = data_folder("scenes")
    return [str(path.relative_to(folder).with_suffix("").as_posix()) for path in sorted(folder.rglob("*.toml"))]

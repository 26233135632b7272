"""What the viewer remembers: settings of the last run, and bookmarks by scene. JSON in the user's folder.

A file that cannot be read is ignored with a warning and replaced by the next save. What a file says is taken value by
value: one that is not valid (a technique of another version) is left out, the rest stays.
"""

import contextlib
import json
import logging
import os
import sys
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from glhybrid.camera_text import Pose, parse
from glhybrid.errors import GlhybridError
from glhybrid.image import AOVS, replacing
from glhybrid.settings import Settings
from glhybrid.viewer.session import MODES, Session
from glhybrid.viewer.views import PICTURE

log = logging.getLogger("glhybrid")
VERSION = 1
MOST_BOOKMARKS = 200  # of a scene


def folder() -> Path:
    """Of the user's settings, by the platform's custom; GLHYBRID_CONFIG chooses another."""
    if given := os.environ.get("GLHYBRID_CONFIG"):
        return Path(given)
    if sys.platform == "win32":
        return Path(os.environ.get("APPDATA") or Path.home() / "AppData" / "Roaming") / "glhybrid"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Application Support" / "glhybrid"
    return Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config") / "glhybrid"


def path() -> Path:
    """The file that settings and bookmarks are kept in."""
    return folder() / "viewer.json"


def read() -> dict[str, Any]:
    """What was saved; {} where there is nothing or it cannot be read, with a warning for the latter."""
    file = path()
    try:
        values = json.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, RecursionError) as error:
        log.warning("%s: ignored, cannot be read: %s", file, error)
        return {}
    if not isinstance(values, dict) or values.get("version") != VERSION:
        log.warning("%s: ignored, not settings of this viewer", file)
        return {}
    return values


def write(values: dict[str, Any]) -> None:
    """Saves; a folder that cannot be written costs a warning."""
    file = path()
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with replacing(file) as temporary:
            temporary.write_text(json.dumps(values | {"version": VERSION}, indent=1), encoding="utf-8")
    except (OSError, GlhybridError) as error:
        log.warning("%s: the viewer's settings are not saved: %s", file, error)


def restore(session: Session, values: dict[str, Any]) -> None:
    """Puts saved settings into a session; what is not valid is left out with a warning."""
    for side in ("a", "b"):
        saved = values.get(side)
        for key, value in saved.items() if isinstance(saved, dict) else ():
            try:
                setattr(session, side, Settings.from_dict(getattr(session, side).to_dict() | {key: value}))
            except (GlhybridError, TypeError) as error:
                log.warning("%s: %s of side %s is ignored: %s", path(), key, side, error)
    checks: dict[str, Any] = {
        "mode": lambda v: v in MODES,
        "against": lambda v: v in ("reference", "b"),
        "show": lambda v: v == PICTURE or v in AOVS,
        "divider": lambda v: isinstance(v, float) and 0 <= v <= 1,
        "gain": lambda v: isinstance(v, float) and 1 <= v <= 64,
        "panel": lambda v: isinstance(v, bool),
        "reference": lambda v: isinstance(v, bool),
    }
    for name, valid in checks.items():
        if name in values and valid(values[name]):
            setattr(session, name, values[name])
        elif name in values:
            log.warning("%s: %s = %r is ignored", path(), name, values[name])


def snapshot(session: Session) -> dict[str, Any]:
    """What is kept of a session; time, camera and light belong to a scene and are not."""
    sides = {side: _changed(getattr(session, side)) for side in ("a", "b")}
    names = ("mode", "against", "show", "divider", "gain", "panel", "reference")
    return sides | {name: getattr(session, name) for name in names}


def _changed(settings: Settings) -> dict[str, Any]:
    plain = Settings().to_dict()
    values = {k: v for k, v in settings.to_dict().items() if v != plain.get(k, ...) and k not in ("time", "clip")}
    return values | {"shadows": settings.shadows, "reflections": settings.reflections}


class Bookmarks:
    """Named cameras of each scene, by its file's path (built-in scenes: their name)."""

    def __init__(self, saved: dict[str, Any]) -> None:
        found = saved.get("bookmarks")
        self._all: dict[str, list[dict[str, Any]]] = {}
        for scene, rows in found.items() if isinstance(found, dict) else ():
            good = [row for row in rows if _is_bookmark(row)] if isinstance(rows, list) else []
            if good:
                self._all[str(scene)] = good

    def of(self, scene: str) -> list[tuple[str, Pose]]:
        """Names and cameras, the oldest first."""
        return [(row["name"], _pose(row["pose"])) for row in self._all.get(scene, [])]

    def add(self, scene: str, name: str, pose: Pose) -> None:
        """Replaces one of the same name."""
        self.remove(scene, name)
        rows = self._all.setdefault(scene, [])
        rows.append({"name": name, "pose": asdict(pose)})
        del rows[:-MOST_BOOKMARKS]

    def remove(self, scene: str, name: str) -> None:
        """No error where there is none."""
        self._all[scene] = [row for row in self._all.get(scene, []) if row["name"] != name]
        if not self._all[scene]:
            del self._all[scene]

    def to_dict(self) -> dict[str, Any]:
        """Ready for the file; what __init__ takes."""
        return {"bookmarks": self._all}


def _pose(values: dict[str, Any]) -> Pose:
    known = {f.name for f in fields(Pose)}
    given: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in values.items() if k in known}
    return Pose(**given)


def _is_bookmark(row: object) -> bool:
    if not isinstance(row, dict) or not isinstance(row.get("name"), str) or not isinstance(row.get("pose"), dict):
        return False
    with contextlib.suppress(GlhybridError, TypeError, ValueError):
        parse(_pose(row["pose"]).write())
        return True
    log.warning("%s: bookmark %r is ignored: no camera", path(), row["name"])
    return False

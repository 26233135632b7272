"""The one exception family. Every message names the file, the thing, its value, the limit and the remedy.

`GlhybridError.exit_code` is what the command line returns; anything else that escapes is our own mistake.
"""

import difflib
from collections.abc import Iterable


class GlhybridError(Exception):
    """Base of all errors a user can cause or mend."""

    exit_code = 2


class LoadError(GlhybridError):
    """A file cannot be read or holds what we cannot draw."""


class GeometryError(GlhybridError):
    """A mesh or tree that cannot be traced safely."""


class SettingError(GlhybridError):
    """A setting, key, camera, technique or flag that does not exist or is out of range."""


class OutputError(GlhybridError):
    """A result cannot be written."""


class ShaderError(GlhybridError):
    """A program does not compile or link on this driver."""


class DeviceError(GlhybridError):
    """No usable OpenGL 4.3."""

    exit_code = 3


MOST_NAMES = 40  # of those known, that a message lists


def unknown(kind: str, name: object, known: Iterable[str], listed_by: str = "") -> str:
    """'unknown KIND "NAME"; did you mean "NEAREST"? known: ...' for error messages.

    listed_by: the command that lists what is known, named instead where that is much.
    """
    known = sorted(str(k) for k in known)
    near = difflib.get_close_matches(str(name), known, n=1, cutoff=0.5)
    hint = f' did you mean "{near[0]}"?' if near else ""
    if listed_by and len(known) > MOST_NAMES:
        return f'unknown {kind} "{name}";{hint} `{listed_by}` lists all {len(known)}'
    return f'unknown {kind} "{name}";{hint} known: {", ".join(known) or "none"}'

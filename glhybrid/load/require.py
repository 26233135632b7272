"""Range checks of shape and pattern parameters; the scene file puts its own place in front of the message."""

from collections.abc import Sequence

import numpy as np

from glhybrid.errors import LoadError


class ShapeError(LoadError):
    """A parameter of a shape or pattern that is unknown or out of range."""

    def __init__(self, key: str, value: object, message: str) -> None:
        super().__init__(f"{key} = {_shown(value)}: {message}")


def _shown(value: object) -> str:
    """As TOML would have it, short."""
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, list | tuple):
        text = "[" + ", ".join(_shown(v) for v in value) + "]"
        return text if len(text) < 80 else text[:77] + "..."
    return f'"{value}"' if isinstance(value, str) else repr(value)


def positive(**values: float | Sequence[float]) -> None:
    """Raises ShapeError unless every value is more than 0 and at most 1e9."""
    for key, value in values.items():
        if not ((np.asarray(value) > 0) & (np.asarray(value) <= 1e9)).all():  # NaN fails too
            raise ShapeError(key, value, "must be greater than 0 and at most 1e9")


def counts(high: int, low: int = 1, **values: int | Sequence[int]) -> None:
    """Raises ShapeError unless every value is in a range."""
    for key, value in values.items():
        if not all(low <= n <= high for n in np.atleast_1d(value)):
            raise ShapeError(key, value, f"must be between {low} and {high}")

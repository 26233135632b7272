"""Tables of the report's further parts: the paper again, other renderers."""

from typing import Any


def paper(found: dict[str, Any]) -> str:
    return ""


def peers(found: list[dict[str, Any]]) -> str:
    return ""

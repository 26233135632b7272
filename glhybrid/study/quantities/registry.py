"""Measures by name, with their units; a module of this package for each kind registers its own."""

import inspect
from collections.abc import Callable
from dataclasses import dataclass

from glhybrid.errors import SettingError, unknown
from glhybrid.scene import Study
from glhybrid.study.subject import Measured


@dataclass(frozen=True)
class Quantity:
    """A measure: its name, unit, meaning, and the function that takes it."""

    name: str
    unit: str
    meaning: str  # one line
    measure: Callable[..., Measured]

    def options(self) -> list[str]:
        """Names that the [study] table's options may have."""
        return list(inspect.signature(self.measure).parameters)[1:]


QUANTITIES: dict[str, Quantity] = {}


def quantity(unit: str) -> Callable[[Callable[..., Measured]], Callable[..., Measured]]:
    """Registers a function under its name, with blanks; its docstring's first line is the meaning."""

    def register(function: Callable[..., Measured]) -> Callable[..., Measured]:
        name = function.__name__.replace("_", " ")
        meaning = (inspect.getdoc(function) or "").splitlines()[0]
        QUANTITIES[name] = Quantity(name, unit, meaning, function)
        return function

    return register


def find(study: Study, where: str) -> Quantity:
    """The measure that a [study] table names. Raises SettingError for one, or an option of one, that there is not."""
    if study.measure not in QUANTITIES:
        raise SettingError(f"{where}: [study]: {unknown('measure', study.measure, QUANTITIES)}")
    found = QUANTITIES[study.measure]
    for key in study.options:
        if key not in found.options():
            raise SettingError(f"{where}: [study]: options: {unknown('option', key, found.options())}")
    return found

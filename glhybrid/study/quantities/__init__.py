"""The measures of the failure library: from one technique on one scene to a number with a unit.

A measure takes a Subject and the options of the [study] table, its keyword arguments, and returns a Measured.
"""

from glhybrid.study.quantities import frames, glossy, mirrors, shadows  # noqa: F401  # they register theirs
from glhybrid.study.quantities.registry import QUANTITIES, Quantity, find, quantity

__all__ = ["QUANTITIES", "Quantity", "find", "quantity"]

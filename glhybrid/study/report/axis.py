"""Scales of charts: where values lie, and which are named."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Axis:
    """Values from low to high over pixels from start to end. A logarithmic one keeps a place for 0, past `start`."""

    low: float
    high: float
    start: float
    end: float
    log: bool = True
    zero: float | None = None  # pixel of the value 0 on a logarithmic axis

    def at(self, value: float) -> float:
        """Pixel of a value, kept inside."""
        if self.log:
            if value <= 0 and self.zero is not None:
                return self.zero
            share = (math.log(max(value, self.low)) - math.log(self.low)) / (math.log(self.high) - math.log(self.low))
        else:
            share = (value - self.low) / (self.high - self.low)
        return self.start + min(max(share, 0.0), 1.0) * (self.end - self.start)

    def ticks(self) -> list[float]:
        """Round values, few enough to read."""
        return log_ticks(self.low, self.high) if self.log else linear_ticks(self.low, self.high)


def fit(values: Iterable[float], start: float, end: float, *, log: bool = True, room: float = 0.06) -> Axis:
    """An axis that shows all finite values with some room. On a logarithmic one 0 gets a place of its own."""
    values = [v for v in values if math.isfinite(v)]
    if not log:
        low, high = (min(values), max(values)) if values else (0.0, 1.0)
        margin = (high - low or abs(high) or 1.0) * room
        return Axis(low - margin if low < 0 else min(low, 0.0), high + margin, start, end, log=False)
    positive = [v for v in values if v > 0] or [1.0]
    low, high = min(positive), max(positive)
    factor = max((high / low) ** room, 1.15)
    low, high = low / factor, high * factor
    if high / low < 4:  # a decade's look at what differs by little would be all noise
        middle = math.sqrt(low * high)
        low, high = middle / 2, middle * 2
    has_zero = any(v <= 0 for v in values)
    gap = 30.0 if end > start else -30.0
    return Axis(low, high, start + gap if has_zero else start, end, zero=start + gap * 0.25 if has_zero else None)


def log_ticks(low: float, high: float) -> list[float]:
    """1, 2 and 5 of each decade; more where there is only a part of one, 1 alone where there are many."""
    decades = math.log10(high / low)
    steps: Sequence[float] = (1, 1.5, 2, 3, 4, 5, 7) if decades < 1.2 else (1, 2, 5) if decades <= 3 else (1,)
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    return [s * 10.0**e for e in range(first, last + 1) for s in steps if low <= s * 10.0**e <= high]


def linear_ticks(low: float, high: float, most: int = 6) -> list[float]:
    """At most `most` + 1 round numbers from low to high."""
    raw = (high - low) / most
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(s * power for s in (1, 2, 2.5, 5, 10) if s * power >= raw)
    first = math.ceil(low / step - 1e-9)
    return [round(k * step, 12) for k in range(first, math.floor(high / step + 1e-9) + 1)]


def shown(value: float) -> str:
    """A tick's or a figure's text: three digits, no exponent where it can be read without. PSNR of equal images is ∞."""
    if not math.isfinite(value):
        return "none" if math.isnan(value) else "∞" if value > 0 else "-∞"
    if value == 0:
        return "0"
    size = abs(value)
    if 1e-4 <= size < 1e5:
        digits = max(0, 2 - math.floor(math.log10(size)))
        text = f"{value:,.{digits}f}"
        return text.rstrip("0").rstrip(".") if "." in text else text
    mantissa, _, exponent = f"{value:.0e}".partition("e")
    power = f"10{str(int(exponent)).translate(str.maketrans('-0123456789', '⁻⁰¹²³⁴⁵⁶⁷⁸⁹'))}"
    return power if mantissa == "1" else f"{mantissa}·{power}"

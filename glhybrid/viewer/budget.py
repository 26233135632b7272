"""How large a picture may be drawn while things move, so that the window keeps answering."""

from dataclasses import dataclass

# Of a frame in motion. An answer takes two of them at most, the one under way and its own: within 50 ms on a GPU with
# what the panel takes; 5 frames/s on a CPU.
GPU_MS, SOFTWARE_MS = 18.0, 140.0
FIRST_SOFTWARE = 0.25  # of each side: the first picture on a CPU, which nobody knows the cost of
REST_S = 0.25  # without motion, before the picture is made in full
SCALES = (1.0, 0.75, 0.5, 0.375, 0.25, 0.1875, 0.125)  # of each side


@dataclass
class Budget:
    """Learns what a pixel costs and says at which share of each side the next frame in motion is drawn."""

    target_ms: float
    scale: float = 1.0  # until there is a measurement
    _cost: float = 0.0  # ms of a picture of full size

    @staticmethod
    def of(software: bool) -> "Budget":
        """What a device of this kind starts with."""
        return Budget(SOFTWARE_MS, FIRST_SOFTWARE) if software else Budget(GPU_MS)

    def note(self, ms: float, scale: float) -> None:
        """A picture at this scale took so long. Dearer ones are believed at once, cheaper ones by halves."""
        cost = ms / scale**2
        self._cost = cost if cost > self._cost else (self._cost + cost) / 2

    def next(self) -> float:
        """The largest scale within the target; a larger one than before only with room to spare."""
        if self._cost > 0:
            fits = [s for s in SCALES if self._cost * s**2 <= self.target_ms * (1.0 if s <= self.scale else 0.75)]
            self.scale = fits[0] if fits else SCALES[-1]
        return self.scale


def scaled(size: tuple[int, int], scale: float) -> tuple[int, int]:
    """Powers of two are avoided: llvmpipe compiles every program anew, for seconds, where an image becomes one."""
    width, height = (max(round(side * scale), 1) for side in size)
    return (width, height) if scale == 1 else (_uneven(width), _uneven(height))


def _uneven(side: int) -> int:
    return side + 1 if side & (side - 1) == 0 else side

"""Arrays that are looked at instead of pictures: coloured textures, made in a thread where that takes its time."""

from collections.abc import Callable, Hashable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

from numpy.typing import NDArray

from glhybrid.scene import U8
from glhybrid.viewer import views


class Painted:
    """The newest coloured array of each side, with its legend. texture(name, rgba): uploads (H, W, 4) under a name."""

    def __init__(self, texture: Callable[[str, U8], Any]) -> None:
        self._texture = texture
        self._thread = ThreadPoolExecutor(1, "glhybrid-views")
        self._under_way: dict[Hashable, tuple[Any, Future[tuple[U8, views.Legend]]]] = {}
        self._done: dict[Hashable, tuple[Any, Any, views.Legend]] = {}

    @property
    def busy(self) -> bool:
        """Whether there will be more to take()."""
        return bool(self._under_way)

    def has(self, side: Hashable, key: Any) -> bool:
        """Whether the array of that key is there, or on its way."""
        return any(table[side][0] == key for table in (self._done, self._under_way) if side in table)

    def start(self, side: Hashable, key: Any, name: str, array: NDArray[Any], look: views.Look) -> None:
        """Colours an array aside: at full size that takes longer than an answer."""
        self._under_way[side] = key, self._thread.submit(_paint, name, array, look)

    def now(self, side: Hashable, key: Any, name: str, array: NDArray[Any], look: views.Look) -> None:
        """Colours an array at once, in place of one that is under way."""
        self._under_way.pop(side, None)
        self._put(side, key, *_paint(name, array, look))

    def take(self, wait: bool = False) -> bool:
        """Uploads what has become colours; whether there was any."""
        done = [side for side, (_, future) in self._under_way.items() if wait or future.done()]
        for side in done:
            key, future = self._under_way.pop(side)
            self._put(side, key, *future.result())
        return bool(done)

    def texture(self, side: Hashable) -> Any:
        """Row 0 at the top; None before there was any."""
        return self._done[side][1] if side in self._done else None

    def legend(self, side: Hashable) -> views.Legend | None:
        """Of that texture."""
        return self._done[side][2] if side in self._done else None

    def clear(self) -> None:
        """All is to be made anew."""
        self._done.clear()
        self._under_way.clear()

    def close(self) -> None:
        """Ends the thread; the textures are the uploader's."""
        self._thread.shutdown(cancel_futures=True)

    def _put(self, side: Hashable, key: Any, pixels: U8, legend: views.Legend) -> None:
        self._done[side] = key, self._texture(f"array {side}", pixels), legend


def _paint(name: str, array: NDArray[Any], look: views.Look) -> tuple[U8, views.Legend]:
    """An array as a texture's pixels, (H, W, 4), and its legend."""
    rgb, legend = views.colour(name, array, look)
    return views.opaque(rgb), legend

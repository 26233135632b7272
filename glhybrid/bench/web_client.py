"""A browser's part in `glhybrid bench --view`, in a process of its own: drags, and notes when frames come.

    python -m glhybrid.bench.web_client URL WxH SECONDS RESTS

prints one JSON object: `moves` [[x, y, s]], `frames` [s], `first` and `last` move of the drag that counts, and the
number of the first move of each of the `rests`. Seconds are of one clock. Frames are not decoded, which a browser does
in some 10 ms.
"""

import asyncio
import json
import sys
import time
from typing import Any
from urllib.parse import urlsplit

import aiohttp

from glhybrid.viewer.latency import RATE, REST_STEP_S, place

FIRST_S = 120.0  # until a scene is loaded and its programs are compiled
PAUSE_S = 0.7  # after a drag, until the picture refines


class Client:
    """moves, frames: as printed."""

    def __init__(self, socket: Any, size: tuple[int, int]) -> None:
        self._socket, self._size = socket, size
        self.moves: list[tuple[float, float, float]] = []
        self.frames: list[float] = []

    async def receive(self) -> None:
        """Notes frames and acknowledges them, until the socket closes."""
        async for message in self._socket:
            if message.type == aiohttp.WSMsgType.BINARY:
                self.frames.append(time.perf_counter())
                await self._socket.send_str('["ack"]')

    async def drag(self, seconds: float) -> None:
        """Moves by the clock, as a mouse does, whether frames come or not."""
        await self._move()
        await self._socket.send_str('["button", 0, true]')
        start, count = time.perf_counter(), 0
        while (now := time.perf_counter() - start) < seconds:
            while count <= now * RATE:
                await self._move()
                count += 1
            await asyncio.sleep(max(count / RATE - (time.perf_counter() - start), 0))

    async def release(self) -> None:
        """Lets the mouse button go."""
        await self._socket.send_str('["button", 0, false]')

    async def _move(self) -> None:
        at = place(len(self.moves), self._size)
        self.moves.append((at.x, at.y, time.perf_counter()))
        await self._socket.send_str(json.dumps(["move", at.x, at.y]))


async def run(url: str, size: tuple[int, int], seconds: float, rests: int) -> dict[str, Any]:
    """One session, as printed. url: the viewer's address with its token."""
    parts = urlsplit(url)
    address = f"{parts.scheme}://{parts.netloc}/events?{parts.query}"
    async with aiohttp.ClientSession() as session, session.ws_connect(address, max_msg_size=0) as socket:
        client = Client(socket, size)
        await socket.send_str(json.dumps(["size", *size]))
        receiving = asyncio.ensure_future(client.receive())
        end = time.perf_counter() + FIRST_S
        while len(client.frames) < 2 and time.perf_counter() < end:
            await asyncio.sleep(0.05)
        await asyncio.sleep(1.0)
        await client.drag(min(seconds, 2.0))  # budgets learn
        first = len(client.moves)
        await client.drag(seconds)
        last, began = len(client.moves), []
        for number in range(rests):
            await client.release()
            await asyncio.sleep(PAUSE_S + number * REST_STEP_S)
            began.append(len(client.moves) + 1)  # the button goes down at the one before
            await client.drag(0.4)
        await client.release()
        await asyncio.sleep(0.3)
        receiving.cancel()
        return {"moves": client.moves, "frames": client.frames, "first": first, "last": last, "rests": began}


if __name__ == "__main__":
    wide, high = (int(v) for v in sys.argv[2].split("x"))
    print(json.dumps(asyncio.run(run(sys.argv[1], (wide, high), float(sys.argv[3]), int(sys.argv[4])))))

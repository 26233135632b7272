"""The viewer in a browser: frames go out over a websocket, pointer and keys come back. By aiohttp.

The server runs in a thread of its own and touches no OpenGL; the viewer's thread leaves its newest frame there. The
next frame is sent when the browser has shown the last one, so a slow line costs frames, not delay. JPEG in motion, PNG
at rest: then the browser has `render`'s pixels. A PNG takes a while to make and to show: motion waits for neither. One
browser at a time; a new one takes over.

Loopback unless told otherwise, a random token in the URL, and requests whose Host or Origin is another are refused
(a page elsewhere must not reach in through the user's browser).
"""

import asyncio
import contextlib
import hmac
import json
import logging
import math
import secrets
import sys
import threading
from collections import deque
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from glhybrid.context import Context, open_context
from glhybrid.errors import SettingError
from glhybrid.viewer import need
from glhybrid.viewer.encoder import SLOTS, Coded, Encoders
from glhybrid.viewer.events import KEYS, Button, Event, Focus, Key, Move, Text, Wheel
from glhybrid.viewer.surface import Memory

log = logging.getLogger("glhybrid")
SMALLEST, LARGEST = (160, 120), (4096, 4096)  # pixels of a browser's window that are served
MOST_EVENTS = 1000  # waiting; more are dropped
SWITCH_S = 0.0005  # Python's threads take turns: three of them hand a frame on, by default after 5 ms each
LOOPBACK = ("127.0.0.1", "localhost", "::1")
PAGES = {"/": ("page.html", "text/html"), "/page.js": ("page.js", "text/javascript")}
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'unsafe-inline'; connect-src 'self'; "
    "img-src 'self' blob:; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "Referrer-Policy": "no-referrer", "X-Content-Type-Options": "nosniff", "Cache-Control": "no-store",
}  # fmt: skip


def parse(text: str) -> Event | tuple[int, int] | str | None:
    """A message of the browser: an event, ("size") a size, "ack"; None for what is none of these."""
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        return None
    if not isinstance(message, list) or not message or not isinstance(message[0], str):
        return None
    kind, values = message[0], message[1:]
    numbers = [float(v) for v in values if isinstance(v, (int, float)) and math.isfinite(v) and abs(v) < 1e6]
    exact = len(numbers) == len(values) == 2
    if kind == "ack":
        return "ack"
    if kind == "move" and exact:
        return Move(*numbers)
    if kind == "wheel" and exact:
        return Wheel(*(min(max(v, -20.0), 20.0) for v in numbers))
    if kind == "size" and exact:
        return tuple(int(min(max(v, low), high)) for v, low, high in zip(numbers, SMALLEST, LARGEST, strict=True))  # type: ignore[return-value]
    if kind == "button" and len(values) == 2 and values[0] in (0, 1, 2) and isinstance(values[1], bool):
        return Button(int(values[0]), values[1])
    if kind == "key" and len(values) == 3 and isinstance(values[0], str) and values[0] in KEYS:
        return Key(values[0], values[1] is True, values[2] is True)
    if kind == "text" and len(values) == 1 and isinstance(values[0], str) and len(values[0]) <= 16:
        return Text(values[0])
    if kind == "focus" and len(values) == 1 and isinstance(values[0], bool):
        return Focus(values[0])
    return None


class Web(Memory):
    """A surface whose display is a browser. url: to open there. Raises SettingError for an address that is taken.

    sent(tag): told of each frame that goes out, in the server's thread, with what `tag` was when it was presented.
    """

    def __init__(
        self, device: str | Context, size: tuple[int, int], host: str = "127.0.0.1", port: int = 0, scale: float = 1.0
    ) -> None:
        self._web = need("aiohttp.web", "web")
        context = open_context(device) if isinstance(device, str) else device
        super().__init__(context, size, scale)
        self._host, self._port, self.token = host, port, secrets.token_urlsafe(24)
        self._lock = threading.Condition()
        self._queue: deque[Event] = deque()
        self._wanted_size = size
        self._latest: Coded | None = None
        self._coding: list[Coded] = []  # whose slots are being read
        self._encoders = Encoders(4 * LARGEST[0] * LARGEST[1])
        self.tag: Any = None
        self.sent: Callable[[Any], None] = lambda tag: None
        self._client: Any = None
        self._news: asyncio.Event | None = None  # a frame was presented, made, or shown
        self._failure: OSError | None = None
        started = threading.Event()
        self._switch_s = sys.getswitchinterval()
        sys.setswitchinterval(SWITCH_S)
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._serve, args=(started,), daemon=True, name="glhybrid-web")
        self._thread.start()
        started.wait()
        if self._failure is not None:
            self._encoders.close()
            sys.setswitchinterval(self._switch_s)
            context.close()
            reason = self._failure.strerror or self._failure
            raise SettingError(f"--web {port}: cannot listen at {host}: {reason}; --web 0 takes a free port")
        shown = f"[{host}]" if ":" in host else host
        self.url = f"http://{shown}:{self._port}/?token={self.token}"
        if host not in LOOPBACK:
            log.warning("anybody who can reach %s and knows this URL can use the viewer; nothing is encrypted", host)

    # The viewer's thread

    @property
    def visible(self) -> bool:  # type: ignore[override]
        """Whether a browser is looking."""
        return self._client is not None

    @property
    def size(self) -> tuple[int, int]:
        """What the browser had asked for by the last poll(), pixels."""
        return self._size

    def poll(self, timeout: float) -> list[Event]:
        """Waits for the browser; where it asked for another size, an event is sure to come."""
        with self._lock:
            if not self._queue and self._wanted_size == self._size and timeout > 0:
                self._lock.wait(timeout)
            found = [*self._events, *self._queue]
            self._events.clear()
            self._queue.clear()
            if self._wanted_size != self._size:
                self._size = self._wanted_size
                found.append(Move(-1.0, -1.0))  # something happened: a frame of the new size is due
        return found

    def present(self, image: Any, moving: bool) -> None:
        """Copies it for the encoder, which has the newest picture only."""
        super().present(image, moving)
        if self._client is None:
            return
        self.context.raw.glFinish()  # unlike read_into(), it lets the server's thread go on
        with self._lock:
            while not (free := self._free()):
                self._lock.wait(0.1)
        with self._encoders.slot(free[0]) as slot:
            image.read_into(slot, components=4)
        with self._lock:
            self._latest = Coded(free[0], image.size, not moving, self.tag)
        self._call(self._wake)

    def _free(self) -> list[int]:
        """Slots whose pixels nobody needs."""
        kept = self._coding if self._latest is None else [self._latest, *self._coding]
        return [slot for slot in range(SLOTS) if all(slot != frame.slot for frame in kept)]

    def title(self, text: str) -> None:
        super().title(text)
        self._tell(title=text)

    def cursor(self, name: str) -> None:
        self._tell(cursor=name)

    def set_clipboard(self, text: str) -> None:
        super().set_clipboard(text)
        self._tell(clipboard=text)

    def close(self) -> None:
        """Ends the server. Twice is harmless."""
        if self._thread.is_alive():
            self._tell(bye="the viewer was closed")
            self._call(self._stop.set)
            self._thread.join(5)
            self._encoders.close()
            sys.setswitchinterval(self._switch_s)

    def _call(self, function: Any, *arguments: Any) -> None:
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(function, *arguments)

    def _tell(self, **order: str) -> None:
        self._call(lambda: self._loop.create_task(self._send_order(order)))

    # The server's thread

    def _serve(self, started: threading.Event) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_until_complete(self._main(started))
        finally:
            started.set()
            self._loop.close()

    async def _main(self, started: threading.Event) -> None:
        web = self._web
        self._stop, self._news = asyncio.Event(), asyncio.Event()
        app = web.Application(client_max_size=1 << 16)
        for path in PAGES:
            app.router.add_get(path, self._page)
        app.router.add_get("/events", self._events_socket)
        runner = web.AppRunner(app, access_log=None, shutdown_timeout=1.0)
        await runner.setup()
        try:
            site = web.TCPSite(runner, self._host, self._port)
            await site.start()
            self._port = runner.addresses[0][1]
        except OSError as error:
            self._failure = error
            await runner.cleanup()
            return
        started.set()
        await self._stop.wait()
        if self._client is not None:
            await self._client.close()
        await runner.cleanup()

    def _allowed(self, request: Any, token: bool) -> bool:
        host = urlsplit(f"//{request.headers.get('Host', '')}").hostname
        if self._host in LOOPBACK and host not in LOOPBACK:
            return False  # another name that was made to point here
        origin = request.headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc != request.headers.get("Host"):
            return False
        given = request.query.get("token", "")
        return not token or hmac.compare_digest(given.encode(), self.token.encode())

    async def _page(self, request: Any) -> Any:
        name, kind = PAGES[request.path]
        if not self._allowed(request, token=request.path == "/"):
            return self._web.Response(status=403, text="glhybrid: the URL with its token is in the terminal\n")
        body = Path(__file__).with_name(name).read_bytes()
        return self._web.Response(body=body, content_type=kind, charset="utf-8", headers=HEADERS)

    async def _events_socket(self, request: Any) -> Any:
        if not self._allowed(request, token=True):
            return self._web.Response(status=403, text="glhybrid: wrong token\n")
        # Pictures are compressed: to deflate them again, as browsers ask for, takes longer than all the rest.
        socket = self._web.WebSocketResponse(max_msg_size=1 << 12, heartbeat=20.0, compress=False)
        await socket.prepare(request)
        old, self._client, unseen = self._client, socket, deque[bool]()
        if old is not None:
            await old.send_str(json.dumps({"bye": "another browser has taken over"}))
            await old.close()
        sender = self._loop.create_task(self._send_frames(socket, unseen))
        self._put(Focus(True))
        try:
            async for message in socket:
                if message.type == self._web.WSMsgType.TEXT:
                    self._receive(message.data, unseen)
        finally:
            sender.cancel()
            if self._client is socket:
                self._client = None
                self._put(Focus(False))
        return socket

    def _receive(self, text: str, unseen: deque[bool]) -> None:
        found = parse(text)
        if found == "ack":
            if unseen:
                unseen.popleft()
            self._wake()
        elif isinstance(found, tuple):
            with self._lock:
                self._wanted_size = found
                self._lock.notify()
        elif found is not None and not isinstance(found, str):
            self._put(found)

    def _put(self, event: Event) -> None:
        with self._lock:
            if isinstance(event, Move) and self._queue and isinstance(self._queue[-1], Move):
                self._queue[-1] = event  # only the last place counts
            elif len(self._queue) < MOST_EVENTS:
                self._queue.append(event)
            self._lock.notify()

    def _wake(self) -> None:
        assert self._news is not None
        self._news.set()

    async def _send_frames(self, socket: Any, unseen: deque[bool]) -> None:
        """unseen: of each frame that was sent and the browser has not shown, whether it is exact.

        One in motion waits for no exact one: neither until it is made, nor sent, nor shown.
        """
        assert self._news is not None
        taken: Coded | None = None
        coding: asyncio.Future[bytes] | None = None
        while not socket.closed:
            self._news.clear()
            latest = self._latest
            if coding is not None and coding.done():
                assert taken is not None
                data, coding = coding.result(), None
                unseen.append(taken.exact)
                try:
                    await socket.send_bytes(data)
                except (ConnectionError, RuntimeError):
                    return
                self.sent(taken.tag)
            elif (
                latest is not None and latest is not taken
                and (not unseen or (all(unseen) and not latest.exact))
                and (coding is None or (taken is not None and taken.exact and not latest.exact))
                and not (latest.exact and any(frame.exact for frame in self._coding))
            ):  # fmt: skip
                with self._lock:
                    taken = self._latest
                    assert taken is not None
                    self._coding.append(taken)
                coding = asyncio.ensure_future(self._loop.run_in_executor(None, self._encoders.encode, taken))
                coding.add_done_callback(partial(self._coded, taken))
            else:
                await self._news.wait()

    def _coded(self, frame: Coded, _: Any) -> None:
        with self._lock:
            self._coding.remove(frame)
            self._lock.notify()
        self._wake()

    async def _send_order(self, order: dict[str, str]) -> None:
        if self._client is not None and not self._client.closed:
            with contextlib.suppress(ConnectionError, RuntimeError):
                await self._client.send_str(json.dumps(order))

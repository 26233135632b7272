"""The viewer in a browser: what is served to whom, frames over a websocket, and headless Chromium driving it."""

import asyncio
import base64
import contextlib
import io
import json
import shutil
import subprocess
import threading
import time
from collections.abc import Callable, Coroutine, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import glhybrid
from glhybrid import Renderer
from glhybrid.context import Context
from glhybrid.errors import SettingError
from glhybrid.viewer.app import Viewer
from glhybrid.viewer.events import Button, Focus, Key, Move, Text, Wheel
from glhybrid.viewer.panels import WIDTH
from glhybrid.viewer.session import Session
from glhybrid.viewer.web import Web, parse

aiohttp = pytest.importorskip("aiohttp", reason="the extra `web` is not installed")
SIZE = (WIDTH + 64, 150)


@pytest.fixture
def served(context: Context) -> Iterator[tuple[Viewer, Web]]:
    surface = Web(context, SIZE)
    viewer = Viewer(surface, Session(glhybrid.load("cornell"), "cornell"), glhybrid.load, watch=False)
    yield viewer, surface
    viewer.close()
    surface.close()


def drive(
    viewer: Viewer,
    work: Callable[[], Coroutine[Any, Any, Any]],
    patience: float = 60.0,
    between: Callable[[], None] = lambda: None,
) -> Any:
    """Runs a client in a thread while the viewer ticks here, as it does for users. between: called after each tick."""
    found: list[Any] = []

    def run() -> None:
        try:
            found.append(asyncio.run(asyncio.wait_for(work(), patience)))
        except BaseException as error:
            found.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    while thread.is_alive():
        viewer.tick()
        between()
    if isinstance(found[0], BaseException):
        raise found[0]
    return found[0]


def address(surface: Web, path: str = "/events", token: str | None = None) -> str:
    base = surface.url.partition("/?")[0]
    return f"{base}{path}?token={surface.token if token is None else token}"


def pixels(data: bytes) -> np.ndarray:
    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))


def test_only_the_token_opens_it_and_only_from_here(served: tuple[Viewer, Web]) -> None:
    viewer, surface = served

    async def statuses() -> list[int]:
        base, found = surface.url.partition("/?")[0], []
        async with aiohttp.ClientSession() as session:
            for path, headers in (
                (surface.url, {}), (f"{base}/", {}), (f"{base}/?token=wrong", {}), (f"{base}/page.js", {}),
                (f"{base}/../secret", {}), (surface.url, {"Host": "evil.example"}),
                (surface.url, {"Origin": "http://evil.example"}), (address(surface, token="x"), {}),
            ):  # fmt: skip
                async with session.get(path, headers=headers) as answer:
                    found.append(answer.status)
                    if answer.status == 200:
                        assert "default-src 'none'" in answer.headers["Content-Security-Policy"]
        return found

    assert drive(viewer, statuses) == [200, 403, 403, 200, 404, 403, 403, 403]
    assert "127.0.0.1" in surface.url and len(surface.token) >= 32


def test_frames_come_and_input_goes(served: tuple[Viewer, Web], context: Context) -> None:
    viewer, surface = served
    sent: list[int] = []  # numbers of the frames that went out
    surface.sent = sent.append
    due: list[Callable[[], bool]] = []  # what the client waits for
    settled = threading.Event()

    def present(image: Any, moving: bool) -> None:
        surface.tag = viewer.frames
        Web.present(surface, image, moving)

    def look() -> None:
        """Between two turns of the viewer: whether what is due has come, is finished, and has gone out."""
        finished = not viewer.pictures.busy and viewer._dirty == 0
        if due and due[0]() and finished and sent and sent[-1] == surface.tag:
            settled.set()

    surface.present = present  # type: ignore[method-assign]

    async def client() -> np.ndarray:
        async with aiohttp.ClientSession() as session, session.ws_connect(address(surface), max_msg_size=0) as socket:
            await socket.send_str(json.dumps(["size", SIZE[0] + 32, SIZE[1]]))
            last, came = np.zeros((0, 0, 3)), 0

            async def frames(enough: Callable[[], bool]) -> None:
                nonlocal last, came
                due[:] = [enough]
                settled.clear()
                while not settled.is_set() or came < len(sent):
                    with contextlib.suppress(TimeoutError):
                        message = await asyncio.wait_for(socket.receive(), 0.1)
                        if message.type == aiohttp.WSMsgType.BINARY:
                            last, came = pixels(message.data), came + 1
                            await socket.send_str('["ack"]')
                due.clear()

            await frames(lambda: surface.size == (SIZE[0] + 32, SIZE[1]))
            assert last.shape[:2] == (SIZE[1], SIZE[0] + 32)
            for message in (["move", 40, 80], ["button", 0, True], ["move", 60, 70], ["button", 0, False], "nonsense",
                            ["key", "nonsense", True, False], ["wheel", 1e300, 0]):  # fmt: skip
                await socket.send_str(json.dumps(message))
            await frames(lambda: viewer.session.pose is not None)
            return last

    got = drive(viewer, client, between=look)
    end = time.monotonic() + 30
    while surface.visible and time.monotonic() < end:  # until the server's thread hears of it
        time.sleep(0.01)
    assert not surface.visible  # nobody looks: nothing is drawn
    width, height = SIZE[0] + 32 - WIDTH, SIZE[1]
    with Renderer(context=context) as renderer:
        want = renderer.render(viewer.session.scene, viewer.session.camera(), (width, height)).rgb
    assert got.shape == (height, SIZE[0] + 32, 3)
    assert np.array_equal(got[-20:, :width], want[-20:])


def test_another_browser_takes_over_and_a_broken_line_is_mended(served: tuple[Viewer, Web]) -> None:
    viewer, surface = served

    async def frame(socket: Any) -> bytes:
        while True:
            message = await asyncio.wait_for(socket.receive(), 30)
            assert message.type in (aiohttp.WSMsgType.BINARY, aiohttp.WSMsgType.TEXT), message
            if message.type == aiohttp.WSMsgType.BINARY:
                await socket.send_str('["ack"]')
                return bytes(message.data)

    async def bye(socket: Any) -> str:
        """What is said before the line is closed."""
        said = ""
        while True:
            message = await asyncio.wait_for(socket.receive(), 30)
            if message.type == aiohttp.WSMsgType.TEXT:
                said = json.loads(message.data).get("bye", said)
            elif message.type != aiohttp.WSMsgType.BINARY:
                return said

    async def clients() -> str:
        async with aiohttp.ClientSession() as session:
            first = await session.ws_connect(address(surface), max_msg_size=0)
            await frame(first)
            second = await session.ws_connect(address(surface), max_msg_size=0)
            said = await bye(first)
            await second.send_str('["size", 500, 200]')
            while pixels(await frame(second)).shape != (200, 500, 3):
                pass
            assert second._response.connection is not None
            second._response.connection.transport.abort()  # as where a network goes away: no word of it
            third = await session.ws_connect(address(surface), max_msg_size=0)
            assert pixels(await frame(third)).shape == (200, 500, 3)  # at once, though nothing has moved
            await third.close()
        return said

    assert "taken over" in drive(viewer, clients)


def test_messages_are_read_strictly() -> None:
    good = {
        '["move", 3, 4.5]': Move(3, 4.5), '["button", 0, true]': Button(0, True), '["wheel", 0, -1]': Wheel(0, -1),
        '["key", "a", true, false]': Key("a", True), '["text", "é"]': Text("é"), '["focus", false]': Focus(False),
        '["size", 99999, 5]': (4096, 120), '["ack"]': "ack",
    }  # fmt: skip
    for text, want in good.items():
        assert parse(text) == want, text
    for text in (
        "", "[]", "{}", "[1]", '["move"]', '["move", "3", 4]', '["move", NaN, 1]', '["move", 1e400, 1]', '["key", "ä", true]',
        '["key", ["a"], true, false]', '["button", 7, true]', '["button", 0, 1]', '["text", 5]', '["size", null, 1]', "[" * 3000,
        '["text", "' + "a" * 17 + '"]', '["quit"]',
    ):  # fmt: skip
        assert parse(text) is None, text


def test_a_taken_port_is_said(served: tuple[Viewer, Web], context: Context, monkeypatch: pytest.MonkeyPatch) -> None:
    port = int(served[1].url.split(":")[2].split("/")[0])
    monkeypatch.setattr(context, "close", lambda: None)
    with pytest.raises(SettingError, match=f"--web {port}: cannot listen"):
        Web(context, SIZE, port=port)


def _chromium() -> str:
    found = next((p for n in ("chromium", "chromium-browser", "google-chrome") if (p := shutil.which(n))), None)
    return found or pytest.skip("no Chromium: the websocket client above stands for it")


def test_chromium_shows_renders_pixels_and_steers(served: tuple[Viewer, Web], context: Context, tmp_path: Path) -> None:
    """A real browser, without a display: its screenshot is the viewer's canvas, and its pointer turns the camera."""
    viewer, surface = served
    browser = subprocess.Popen(
        [_chromium(), "--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-port=0", "--no-first-run",
         f"--user-data-dir={tmp_path / 'profile'}", "--force-color-profile=srgb", "--hide-scrollbars", "about:blank"],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        got, turned = drive(viewer, lambda: _look(surface, viewer, tmp_path / "profile"), 90.0)
    finally:
        browser.terminate()
        browser.wait(20)
    assert got.shape == (SIZE[1], SIZE[0], 3)
    width = SIZE[0] - WIDTH
    with Renderer(context=context) as renderer:
        want = renderer.render(viewer.session.scene, size=(width, SIZE[1])).rgb
    assert np.array_equal(got[-20:, :width], want[-20:])
    assert turned is not None and viewer.session.mode == "split"


async def _look(surface: Web, viewer: Viewer, profile: Path) -> tuple[np.ndarray, Any]:
    """By the DevTools protocol: opens the page, waits for exact frames, takes a screenshot, drags, presses M."""
    end = time.monotonic() + 30
    while not (port := profile / "DevToolsActivePort").exists() or not port.read_text().strip():
        assert time.monotonic() < end, "Chromium did not start"
        await asyncio.sleep(0.1)
    number = port.read_text().split()[0]
    async with aiohttp.ClientSession() as session:
        async with session.get(f"http://127.0.0.1:{number}/json/list") as answer:
            page = next(p for p in await answer.json() if p["type"] == "page")
        async with session.ws_connect(page["webSocketDebuggerUrl"], max_msg_size=0) as socket:
            count = 0

            async def call(method: str, **parameters: Any) -> Any:
                nonlocal count
                count += 1
                await socket.send_str(json.dumps({"id": count, "method": method, "params": parameters}))
                while True:
                    answer = json.loads((await socket.receive()).data)
                    if answer.get("id") == count:
                        return answer["result"]

            async def settled(condition: Callable[[], bool]) -> None:
                stop = time.monotonic() + 40
                before = ""
                while time.monotonic() < stop:
                    script = "canvas.dataset.frames + ' ' + canvas.dataset.exact"
                    value = (await call("Runtime.evaluate", expression=script))["result"].get("value", "")
                    if condition() and not viewer.pictures.busy and value.endswith(" 1") and value == before:
                        return
                    before = value
                    await asyncio.sleep(0.3)
                raise AssertionError(f"no picture came to rest: {before}")

            await call(
                "Emulation.setDeviceMetricsOverride", width=SIZE[0], height=SIZE[1], deviceScaleFactor=1, mobile=False
            )
            await call("Page.navigate", url=surface.url)
            await settled(lambda: viewer.surface.size == SIZE and viewer.pictures.sides["a"].done > 0)
            shot = pixels(base64.b64decode((await call("Page.captureScreenshot", format="png"))["data"]))
            for kind, x in (("mousePressed", 20), ("mouseMoved", 40), ("mouseReleased", 40)):
                await call("Input.dispatchMouseEvent", type=kind, x=x, y=90, button="left", buttons=1, clickCount=1)
            for kind in ("keyDown", "keyUp"):
                await call(
                    "Input.dispatchKeyEvent", type=kind, key="m", code="KeyM", text="m" if kind == "keyDown" else ""
                )
            stop = time.monotonic() + 20
            while (viewer.session.pose is None or viewer.session.mode != "split") and time.monotonic() < stop:
                await asyncio.sleep(0.1)
            return shot, viewer.session.pose

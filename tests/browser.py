"""A real browser for tests: Chromium without a window, spoken to over its debugging protocol (CDP).

Tests that need it are skipped with a reason where there is none.
"""

from __future__ import annotations

import base64
import json
import os
import shutil
import signal
import subprocess
import tempfile
import time
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

from tests.programs import BROWSERS, program
from tests.waiting import PATIENCE, until

KEYS = {"ArrowLeft": 37, "ArrowRight": 39, "ArrowUp": 38, "ArrowDown": 40, "Escape": 27, "Tab": 9, "Enter": 13, " ": 32,
        "PageUp": 33, "PageDown": 34}


SELDOM = """{
  const draw = window.often = requestAnimationFrame.bind(window);
  window.requestAnimationFrame = frame => setTimeout(() => draw(frame), 80);
}"""  # a frame in 80 ms and not in 16, since a processor that draws them all does little else; `often`: as ever


class Page:
    """One tab. Not thread-safe; events that came in meanwhile are in `console`."""

    def __init__(self, address: str) -> None:
        self._connect(address)
        for domain in ("Page", "Runtime", "Log"):
            self.call(domain + ".enable")

    def _connect(self, address: str) -> None:
        from websockets.sync.client import connect

        self._open = ExitStack()
        self.socket = self._open.enter_context(
            connect(address, max_size=None, open_timeout=PATIENCE, ping_interval=None))
        self.number = 0
        self.console: list[str] = []
        self.frames: list[str] = []  # what its sockets were sent, once `Network` is enabled

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Call a method of the protocol and wait for its answer."""
        self.number += 1
        self.socket.send(json.dumps({"id": self.number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self.socket.recv(timeout=PATIENCE))
            if message.get("id") == self.number:
                assert "error" not in message, (method, message)
                result: dict[str, Any] = message["result"]
                return result
            self._note(message)

    def _note(self, message: dict[str, Any]) -> None:
        method, given = message.get("method"), message.get("params", {})
        if method == "Runtime.consoleAPICalled":
            self.console.append(" ".join(str(one.get("value")) for one in given["args"]))
        elif method == "Runtime.exceptionThrown":
            detail = given["exceptionDetails"]
            self.console.append(detail["text"] + " " + str(detail.get("exception", {}).get("description")))
        elif method == "Network.webSocketFrameReceived":
            self.frames.append(given["response"]["payloadData"])
        elif method == "Log.entryAdded":
            self.console.append(f"{given['entry']['source']}: {given['entry']['text']}")

    def evaluate(self, expression: str) -> Any:
        """The value of an expression of JavaScript in the page; a promise is waited for."""
        got = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in got, (expression, got["exceptionDetails"])
        return got["result"].get("value")

    def text(self, selector: str) -> str:
        """The text of the first element that this selector finds."""
        return str(self.evaluate(f"document.querySelector({json.dumps(selector)}).textContent"))

    def until(self, expression: str) -> None:
        """Wait until an expression is true."""
        until(lambda: self.evaluate(expression), f"never true: {expression}")

    def go(self, url: str) -> None:
        """Open an address and wait until the document is there."""
        self.call("Page.navigate", url=url)
        self.until("document.readyState === 'complete' && location.href !== 'about:blank'")

    def size(self, width: int, height: int, *, scale: float = 1.0, mobile: bool = False) -> None:
        """Give the tab this size in px."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=scale,
                  mobile=mobile)

    def media(self, **features: str) -> None:
        """Emulate media features: `media(prefers_color_scheme="dark")`."""
        self.call("Emulation.setEmulatedMedia",
                  features=[{"name": name.replace("_", "-"), "value": value} for name, value in features.items()])

    def place(self, selector: str) -> tuple[float, float]:
        """The middle of an element, scrolled into view, in px."""
        x, y = self.evaluate(
            f"(e => {{ e.scrollIntoView({{block: 'center'}}); const b = e.getBoundingClientRect(); "
            f"return [b.x + b.width / 2, b.y + b.height / 2]; }})(document.querySelector({json.dumps(selector)}))")
        return x, y

    def mouse(self, kind: str, x: float, y: float, **other: Any) -> None:
        """A mouse event: mousePressed, mouseMoved, mouseReleased, mouseWheel."""
        held = {"mousePressed": 1, "mouseReleased": 0}.get(kind, other.pop("buttons", 0))
        button = "left" if kind in ("mousePressed", "mouseReleased") or held else "none"
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button, buttons=held,
                  **{"clickCount": 1, **other})

    def drag(
        self, start: tuple[float, float], by: tuple[float, float], *, steps: int = 12, release: bool = True
    ) -> None:
        """Press at `start`, move by so many px in steps, and let go."""
        x, y = start
        self.mouse("mousePressed", x, y)
        for i in range(1, steps + 1):
            self.mouse("mouseMoved", x + by[0] * i / steps, y + by[1] * i / steps, buttons=1)
            time.sleep(0.016)
        if release:
            self.mouse("mouseReleased", x + by[0], y + by[1])

    def click(self, selector: str) -> None:
        """Click an element."""
        x, y = self.place(selector)
        self.mouse("mousePressed", x, y)
        self.mouse("mouseReleased", x, y)

    def touch(self, kind: str, *points: tuple[float, float]) -> None:
        """A touch event: touchStart, touchMove, touchEnd."""
        self.call("Input.dispatchTouchEvent", type=kind, touchPoints=[{"x": x, "y": y} for x, y in points])

    def key(self, key: str, kind: str = "both", *, shift: bool = False, repeat: bool = False) -> None:
        """A key that goes down and up, or `kind` "down" or "up" alone."""
        code = KEYS.get(key) or ord(key.upper())
        name = "Space" if key == " " else key if len(key) > 1 else "Key" + key.upper()
        common = {"key": key, "code": name, "windowsVirtualKeyCode": code, "modifiers": 8 if shift else 0}
        if kind in ("both", "down"):
            typed = {"text": {"Enter": "\r"}.get(key, key)} if len(key) == 1 or key == "Enter" else {}
            self.call("Input.dispatchKeyEvent", type="keyDown" if typed else "rawKeyDown", autoRepeat=repeat,
                      **common, **typed)
        if kind in ("both", "up"):
            self.call("Input.dispatchKeyEvent", type="keyUp", **common)

    def screenshot(self, **other: Any) -> bytes:
        """A picture of what is shown, PNG unless `format` says otherwise."""
        return base64.b64decode(self.call("Page.captureScreenshot", **{"format": "png", **other})["data"])

    def close(self) -> None:
        with suppress(Exception):
            self.call("Page.close")
        self._open.close()


class Browser:
    """A Chromium without a window and with a profile of its own; `close` ends it and removes the profile."""

    def __init__(self, *options: str) -> None:
        path = program(*BROWSERS)
        self.profile = Path(tempfile.mkdtemp(prefix="browser-"))
        self.process = subprocess.Popen(
            [path, "--headless=new", "--no-sandbox", "--disable-gpu", "--remote-debugging-port=0", "--no-first-run",
             "--disable-background-networking", "--disable-component-update", "--disable-dev-shm-usage",
             "--disable-extensions", "--hide-scrollbars", "--mute-audio", f"--user-data-dir={self.profile}", *options,
             "about:blank"],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
            env={**os.environ, "HOME": str(self.profile)},
        )
        port = self.profile / "DevToolsActivePort"
        try:
            until(lambda: port.exists() and len(port.read_text().split()) == 2, "the browser did not come up")
        except BaseException:
            self.close()
            raise
        number, self.path = port.read_text().split()
        self.host = f"127.0.0.1:{number}"
        self.pages: list[Page] = []
        self._browser = _Plain(f"ws://{self.host}{self.path}")

    def page(self, url: str | None = None, **size: Any) -> Page:
        """A new tab; its console is heard from before the address is opened."""
        target = self._browser.call("Target.createTarget", url="about:blank")["targetId"]
        page = Page(f"ws://{self.host}/devtools/page/{target}")
        self.pages.append(page)
        page.call("Page.addScriptToEvaluateOnNewDocument", source=SELDOM)
        if size:
            page.size(**size)
        if url is not None:
            page.go(url)
        return page

    def close(self) -> None:
        """End the browser with all that it started."""
        with suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        shutil.rmtree(self.profile, ignore_errors=True)


class _Plain(Page):
    """The browser itself, which has no document."""

    def __init__(self, address: str) -> None:
        self._connect(address)

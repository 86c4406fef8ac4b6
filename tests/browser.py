"""Chromium without a window, driven by its DevTools protocol over two pipes: for pages that do something."""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import time
from typing import Sequence, Tuple

PROGRAM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
_OPTIONS = (
    "--headless=new --no-sandbox --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader --hide-scrollbars "
    "--disable-background-networking --disable-component-update --disable-sync --no-first-run --remote-debugging-pipe"
).split()


class Browser:
    """One page of a size (px); ``options`` are more of Chromium's. To be used in a ``with`` block."""

    def __init__(self, folder: str, size: Tuple[int, int] = (1280, 800), options: Sequence[str] = ()) -> None:
        (self._their_read, self._write), (self._read, self._their_write) = os.pipe(), os.pipe()
        command = [PROGRAM, *_OPTIONS, f"--user-data-dir={folder}", f"--window-size={size[0]},{size[1]}", *options]

        def connect():  # Chromium reads from 3 and writes to 4
            ends = os.dup(self._their_read), os.dup(self._their_write)
            os.dup2(ends[0], 3)
            os.dup2(ends[1], 4)

        self._process = subprocess.Popen(
            [*command, "about:blank"], preexec_fn=connect, close_fds=False,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip
        os.close(self._their_read)
        os.close(self._their_write)
        self._number, self._rest, self.requests, self.errors = 0, b"", [], []
        self._session = None
        target = next(t for t in self.ask("Target.getTargets")["targetInfos"] if t["type"] == "page")["targetId"]
        self._session = self.ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network"):
            self.ask(f"{domain}.enable")
        self.ask("Emulation.setDeviceMetricsOverride", width=size[0], height=size[1], deviceScaleFactor=1, mobile=False)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        try:
            self._session = None
            self.ask("Browser.close")
            self._process.wait(10)
        except (OSError, subprocess.TimeoutExpired, AssertionError):
            self._process.kill()
            self._process.wait()
        os.close(self._write)
        os.close(self._read)

    def ask(self, method, timeout=120, **parameters):
        """What the browser answers to one command."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        end = time.monotonic() + timeout
        while True:
            answer = self._next(end - time.monotonic())
            if answer.get("id") == self._number:
                assert "error" not in answer, answer["error"]
                return answer["result"]
            if answer.get("method") == "Network.requestWillBeSent":
                self.requests.append(answer["params"]["request"]["url"])
            if answer.get("method") == "Runtime.exceptionThrown":
                self.errors.append(answer["params"]["exceptionDetails"])

    def _next(self, seconds):
        while b"\0" not in self._rest:
            assert select.select([self._read], [], [], max(seconds, 0))[0], "the browser does not answer"
            data = os.read(self._read, 1 << 20)
            assert data, "the browser has ended"
            self._rest += data
        line, self._rest = self._rest.split(b"\0", 1)
        return json.loads(line)

    def evaluate(self, script):
        """The JSON value of an expression; promises are waited for."""
        found = self.ask("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def open(self, path):
        self.ask("Page.navigate", url=f"file://{path}")

    def wait(self, script, seconds=60):
        """Wait until an expression is true; gives its value."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            value = self.evaluate(script)
            if value:
                return value
            time.sleep(0.05)
        raise AssertionError(f"never true in {seconds} s: {script}")

    def frame(self):
        """Wait until what was asked for is drawn."""
        self.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(1))))")

    def mouse(self, kind, place, buttons=0, **more):
        button = "left" if buttons == 1 else "right" if buttons == 2 else "none"
        given = {"type": f"mouse{kind}", "x": place[0], "y": place[1], "button": button, "buttons": buttons, **more}
        self.ask("Input.dispatchMouseEvent", **given)

    def click(self, x, y):
        self.mouse("Moved", (x, y))
        self.mouse("Pressed", (x, y), 1, clickCount=1)
        self.mouse("Released", (x, y), 1, clickCount=1)
        self.frame()

    def drag(self, start, end, buttons=1):
        self.mouse("Pressed", start, buttons, clickCount=1)
        for share in (0.25, 0.5, 0.75, 1.0):
            self.mouse("Moved", [a + (b - a) * share for a, b in zip(start, end)], buttons)
        self.mouse("Released", end, buttons, clickCount=1)
        self.frame()

    def key(self, key, shift=False):
        for kind in ("keyDown", "keyUp"):
            self.ask("Input.dispatchKeyEvent", type=kind, key=key, modifiers=8 if shift else 0)
        self.frame()

    def picture(self, path):
        """A screenshot as a PNG, of what the page shows once it rests: while it moves it may be coarse."""
        time.sleep(0.5)
        self.frame()
        with open(path, "wb") as stream:
            stream.write(base64.b64decode(self.ask("Page.captureScreenshot", format="png")["data"]))

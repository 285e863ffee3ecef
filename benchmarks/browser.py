"""A page in headless Chromium, steered over a pipe by the DevTools protocol."""

import base64
import json
import os
import shutil
import subprocess
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Any

FLAGS = ("--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
         "--hide-scrollbars", "--remote-debugging-pipe")  # fmt: skip
START = 'exec "$@" 3</dev/fd/{} 4>/dev/fd/{}'
"""Chromium reads its commands from descriptor 3 and writes the answers to 4."""


class Browser:
    """Chromium with one page; leaving the context ends it. Raises ``RuntimeError`` without it."""

    def __init__(self) -> None:
        """Start the browser with an empty page."""
        chromium = shutil.which("chromium")
        if chromium is None:
            raise RuntimeError("chromium is not installed (Debian package chromium)")
        self._profile = TemporaryDirectory(ignore_cleanup_errors=True)
        to_read, commands = os.pipe()
        answers, to_write = os.pipe()
        arguments = [chromium, *FLAGS, f"--user-data-dir={self._profile.name}"]
        self._process = subprocess.Popen(
            ["sh", "-c", START.format(to_read, to_write), "sh", *arguments],
            pass_fds=(to_read, to_write), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        os.close(to_read)
        os.close(to_write)
        self._commands, self._answers = os.fdopen(commands, "wb", 0), os.fdopen(answers, "rb")
        self._unread, self._number, self._session, self._loaded = b"", 0, "", False
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        self.call("Page.enable")

    def __enter__(self) -> "Browser":
        """Return the browser."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        """End the browser and remove its profile."""
        self._process.terminate()
        self._process.wait(20)
        self._commands.close()
        self._answers.close()
        self._profile.cleanup()

    def _message(self) -> dict[str, Any]:
        """The next message of the browser; messages end with a zero byte."""
        while b"\0" not in self._unread:
            more = os.read(self._answers.fileno(), 1 << 20)
            if not more:
                raise RuntimeError("chromium ended")
            self._unread += more
        text, self._unread = self._unread.split(b"\0", 1)
        message: dict[str, Any] = json.loads(text)
        self._loaded |= message.get("method") == "Page.loadEventFired"
        return message

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Return the result of a method of the protocol; raises ``RuntimeError`` where it fails."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        self._commands.write(json.dumps(message).encode() + b"\0")
        while (answer := self._message()).get("id") != self._number:
            pass
        if "error" in answer:
            raise RuntimeError(f"{method}: {answer['error']['message']}")
        return answer["result"]

    def open(
        self,
        url: str,
        *,
        width: int,
        height: int = 900,
        dark: bool = False,
        script: bool = True,
        paper: bool = False,
    ) -> None:
        """Load a page in a window of that many pixels; ``paper`` shows it as it is printed."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height,
                  deviceScaleFactor=1, mobile=False)  # fmt: skip
        scheme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self.call("Emulation.setEmulatedMedia", media="print" if paper else "", features=scheme)
        self.call("Emulation.setScriptExecutionDisabled", value=not script)
        self._loaded = False
        self.call("Page.navigate", url=url)
        while not self._loaded:
            self._message()

    def value(self, expression: str) -> Any:
        """Return the value of an expression in the page, of a promise what it comes to.

        It is evaluated by the debugger, for which a page without script is no obstacle. Raises
        ``RuntimeError`` with the error of the page.
        """
        result = self.call(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        if "exceptionDetails" in result:
            raise RuntimeError(str(result["exceptionDetails"]["exception"].get("description")))
        return result["result"].get("value")

    def result(self, body: str) -> Any:
        """Return what a function with this body returns in the page; see ``value``."""
        return self.value(f"(() => {{ {body}\n}})()")

    def shot(self, *, top: int = 0, height: int | None = None) -> bytes:
        """Return the page, or ``height`` pixels of it from ``top`` on, as PNG."""
        size = self.call("Page.getLayoutMetrics")["cssContentSize"]
        clip = {"x": 0, "y": top, "scale": 1, "width": size["width"]}
        clip["height"] = min(size["height"] - top, height or size["height"])
        picture = self.call("Page.captureScreenshot", clip=clip, captureBeyondViewport=True)
        return base64.b64decode(picture["data"])

    def pdf(self) -> bytes:
        """Return the printed page, A4."""
        done = self.call("Page.printToPDF", paperWidth=8.27, paperHeight=11.69)
        return base64.b64decode(done["data"])

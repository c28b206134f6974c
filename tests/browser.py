"""Headless Chromium for the tests, driven by the DevTools protocol over pipes."""

import base64
import fcntl
import io
import json
import os
import select
import subprocess
import time

import numpy as np
from PIL import Image

WIDTH, HEIGHT = 900, 600
KEY_CODES = {
    "Escape": 27,
    "End": 35,
    "Home": 36,
    "ArrowLeft": 37,
    "ArrowUp": 38,
    "ArrowRight": 39,
    "ArrowDown": 40,
    "Tab": 9,
}
SECONDS = 60.0
"""A browser on a busy machine may take this long to answer."""


class Tab:
    """A page in headless Chromium, by the DevTools protocol over pipes."""

    def __init__(self, chromium, profile):
        ours, theirs = os.pipe(), os.pipe()  # what we read, what it reads
        # away from 3 and 4, where Chromium expects them
        ends = [fcntl.fcntl(fd, fcntl.F_DUPFD, 20) for fd in (theirs[0], ours[1])]
        arguments = ["--headless", "--no-sandbox", "--remote-debugging-pipe", f"--user-data-dir={profile}"]
        arguments += ["--enable-unsafe-swiftshader", "--disable-dev-shm-usage", "--force-device-scale-factor=1"]
        self.process = subprocess.Popen(
            [chromium, *arguments, "about:blank"],
            preexec_fn=lambda: [os.dup2(end, fd) for end, fd in zip(ends, (3, 4), strict=True)],
            pass_fds=(3, 4),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        for fd in (*ends, theirs[0], ours[1]):
            os.close(fd)
        self.read, self.write = ours[0], theirs[1]
        self.count, self.rest, self.events, self.session = 0, b"", [], None

    def open(self, path, width=WIDTH, height=HEIGHT, *, ratio=1, mobile=False):
        """Load the file, or what an address serves, in a window of this size, and wait until it has."""
        target = self("Target.createTarget", url="about:blank")["targetId"]
        self.session = self("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Network", "Runtime", "Log"):
            self(f"{domain}.enable")
        self("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=ratio, mobile=mobile)
        self("Page.navigate", url=path if isinstance(path, str) else path.as_uri())
        while not any(event["method"] == "Page.loadEventFired" for event in self.events):
            self.receive()

    def __call__(self, method, **params):
        """Send a command and return its result."""
        self.count += 1
        message = {"id": self.count, "method": method, "params": params}
        if self.session:
            message["sessionId"] = self.session
        os.write(self.write, json.dumps(message).encode() + b"\0")
        while True:
            answer = self.receive()
            if answer.get("id") == self.count:
                assert "error" not in answer, answer
                return answer["result"]

    def receive(self):
        end = time.monotonic() + SECONDS
        while b"\0" not in self.rest:
            ready, _, _ = select.select([self.read], [], [], max(0.0, end - time.monotonic()))
            assert ready, "Chromium does not answer"
            self.rest += os.read(self.read, 1 << 20)
        line, _, self.rest = self.rest.partition(b"\0")
        answer = json.loads(line)
        if "method" in answer:
            self.events.append(answer)
        return answer

    def run(self, expression):
        answer = self("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def picture(self):
        # two frames later all that was asked for is drawn, on a busy machine in less detail
        frame = "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(1))))"
        self.run(frame)
        self.run("if (typeof pace === 'object' && pace.level) draw()")
        self.run(frame)
        shot = base64.b64decode(self("Page.captureScreenshot", format="png")["data"])
        return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB")).astype(int)

    def mouse(self, kind, x, y, **more):
        self("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def drag(self, start, end):
        self.mouse("mousePressed", *start, button="left", buttons=1, clickCount=1)
        for part in (0.5, 1.0):
            at = (a + part * (b - a) for a, b in zip(start, end, strict=True))
            self.mouse("mouseMoved", *at, button="left", buttons=1)
        self.mouse("mouseReleased", *end, button="left", clickCount=1)

    def click(self, x, y):
        self.mouse("mousePressed", x, y, button="left", buttons=1, clickCount=1)
        self.mouse("mouseReleased", x, y, button="left", clickCount=1)

    def key(self, key):
        """Press and release a key, by its name in the DOM."""
        more = {"text": key} if len(key) == 1 else {"windowsVirtualKeyCode": KEY_CODES[key]}
        self("Input.dispatchKeyEvent", type="keyDown", key=key, **more)
        self("Input.dispatchKeyEvent", type="keyUp", key=key, **more)

    def complaints(self):
        """Messages that the page writes to the console, errors, exceptions, and requests for anything but the page."""
        complaints = []
        for event in self.events:
            method, params = event["method"], event["params"]
            if method == "Runtime.exceptionThrown":
                complaints.append(params)
            if method == "Runtime.consoleAPICalled":
                complaints.append(params["args"])
            if method == "Log.entryAdded" and params["entry"]["level"] == "error":
                complaints.append(params["entry"])
            if method == "Network.requestWillBeSent":
                url = params["request"]["url"]
                if not (url.startswith(("file:///", "data:,")) and url.endswith(("page.html", ","))):
                    complaints.append(url)
        return complaints

    def close(self):
        self.session = None
        try:
            self("Browser.close")
            self.process.wait(timeout=SECONDS)
        finally:
            self.process.kill()
            self.process.wait()
        os.close(self.read)
        os.close(self.write)

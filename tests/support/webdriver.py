"""A headless Chromium for tests, driven through chromedriver's WebDriver interface on loopback: JSON over HTTP."""

import base64
import contextlib
import json
import shutil
import socket
import subprocess
import time
import urllib.request

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
DRIVER = shutil.which("chromedriver")
ARGUMENTS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
    "--disable-background-networking", "--disable-component-update", "--disable-dev-shm-usage",
    "--window-size=1200,900",
)  # fmt: skip
# Loopback must not go through a proxy of the environment
OPENER = urllib.request.build_opener(urllib.request.ProxyHandler({}))


@contextlib.contextmanager
def browser(profile):
    """Yield a Browser with a fresh profile in folder `profile`; both processes end with the context."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    process = subprocess.Popen([DRIVER, f"--port={port}"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        found = Browser(f"http://127.0.0.1:{port}", profile)
        try:
            yield found
        finally:
            found.close()
    finally:
        process.terminate()
        process.wait(timeout=20)


class Browser:
    """One WebDriver session."""

    def __init__(self, server, profile):
        self.url = server
        _wait(server)
        options = {"binary": CHROMIUM, "args": [*ARGUMENTS, f"--user-data-dir={profile}"]}
        asked = {"goog:chromeOptions": options, "goog:loggingPrefs": {"browser": "ALL"}}
        session = self._post("/session", {"capabilities": {"alwaysMatch": asked}})
        self.url = f"{server}/session/{session['sessionId']}"

    def _post(self, path, body, method="POST"):
        request = urllib.request.Request(
            self.url + path, json.dumps(body).encode(), {"Content-Type": "application/json"}, method=method
        )
        with OPENER.open(request, timeout=60) as answer:
            return json.load(answer)["value"]

    def open(self, page):
        self._post("/url", {"url": page})

    def run(self, script, *arguments):
        """Return what a script's function body returns; a promise is waited for."""
        return self._post("/execute/sync", {"script": script, "args": list(arguments)})

    def messages(self):
        """Return what the console has said since it was last asked."""
        return self._post("/se/log", {"type": "browser"})

    def devtools(self, command, **parameters):
        return self._post("/goog/cdp/execute", {"cmd": command, "params": parameters})

    def width(self, pixels, height=740):
        """Show the page as a phone of this width does."""
        self.devtools(
            "Emulation.setDeviceMetricsOverride", width=pixels, height=height, deviceScaleFactor=2, mobile=True
        )

    def click(self, selector):
        element = self._post("/element", {"using": "css selector", "value": selector})
        self._post(f"/element/{next(iter(element.values()))}/click", {})

    def act(self, kind, *actions, **source):
        """Perform WebDriver actions of one input source: kind "pointer", "wheel" or "key"."""
        self._post("/actions", {"actions": [{"type": kind, "id": kind, "actions": list(actions), **source}]})

    def screenshot(self, path):
        path.write_bytes(base64.b64decode(self.devtools("Page.captureScreenshot", format="png")["data"]))

    def close(self):
        self._post("", {}, "DELETE")


def _wait(server, seconds=20):
    end = time.monotonic() + seconds
    while True:
        try:
            with OPENER.open(f"{server}/status", timeout=2):
                return
        except OSError:
            if time.monotonic() > end:
                raise
            time.sleep(0.05)

"""Drives the walkthrough in a headless browser, by its DevTools protocol.

Arguments: the browser, vlf-view, vlf, a pack, and a folder for what is made.
"""

import base64
import io
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import time
import urllib.request

import websocket
from common import PATIENCE, apart, until
from PIL import Image, ImageStat

WIDTH, HEIGHT = 320, 240
# What a screen of 256 steps may be off in the mean: exact pictures are sent over a link like this one.
CLOSE = 0.05


class Browser:
    """A page in a headless browser."""

    def __init__(self, program, profile, address):
        command = [program, "--headless=new", "--remote-debugging-port=0", f"--user-data-dir={profile}",
                   "--remote-allow-origins=*", "--no-first-run", "--disable-gpu",
                   "--force-color-profile=srgb", "--hide-scrollbars", "about:blank"]
        if hasattr(os, "geteuid") and os.geteuid() == 0:
            command.insert(1, "--no-sandbox")  # Chromium has none for root.
        self.process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self.count = 0
        self.thrown = []
        port_file = pathlib.Path(profile) / "DevToolsActivePort"
        port = until(lambda: port_file.exists() and port_file.read_text().split()[:1], "the browser")[0]
        pages = json.load(urllib.request.urlopen(f"http://127.0.0.1:{port}/json"))
        page = next(p for p in pages if p["type"] == "page")
        self.socket = websocket.create_connection(page["webSocketDebuggerUrl"], timeout=PATIENCE)
        self.call("Runtime.enable")
        self.call("Page.enable")
        self.call("Emulation.setDeviceMetricsOverride",
                  width=WIDTH, height=HEIGHT, deviceScaleFactor=1, mobile=False)
        # A page that nobody looks at would have no focus, and be refused the pointer.
        self.call("Page.bringToFront")
        self.call("Page.navigate", url=address)

    def call(self, method, **parameters):
        self.count += 1
        self.socket.send(json.dumps({"id": self.count, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self.socket.recv())
            if answer.get("method") == "Runtime.exceptionThrown":
                self.thrown.append(json.dumps(answer["params"]))
            if answer.get("id") == self.count:
                if "error" in answer:
                    sys.exit(f"{method}: {answer['error']}")
                return answer["result"]

    def value(self, expression):
        return self.call("Runtime.evaluate", expression=expression)["result"].get("value")

    def picture(self):
        shot = self.call("Page.captureScreenshot", format="png")
        return Image.open(io.BytesIO(base64.b64decode(shot["data"]))).convert("RGB")

    def key(self, code, kind):
        text = code[-1].lower() if code.startswith("Key") else code
        self.call("Input.dispatchKeyEvent", type=kind, code=code, key=text)

    def press(self, code):
        self.key(code, "keyDown")
        self.key(code, "keyUp")

    def mouse(self, kind, x, y, down):
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left" if down or kind == "mouseReleased" else "none",
                  buttons=1 if down else 0, clickCount=1)

    def settled(self, what):
        """Waits for the finest picture of the view as it is."""
        self.value("delete document.getElementById('picture').dataset.pass")
        until(lambda: self.value("document.getElementById('picture').dataset.pass") == "1/16", what)
        time.sleep(0.2)


def rendered(vlf, pack, camera, name):
    """What `vlf render` makes of a camera."""
    file = name.with_suffix(".json")
    file.write_text(json.dumps(camera))
    subprocess.run([vlf, "render", pack, "-o", name, "--camera", file, "--method", "trace",
                    "--exposure", "0"], check=True, stderr=subprocess.DEVNULL)
    return Image.open(name).convert("RGB")


def main(program, view, vlf, pack, work):
    work = pathlib.Path(work)
    work.mkdir(parents=True, exist_ok=True)
    server = subprocess.Popen([view, pack, "--serve", "127.0.0.1:0", "--method", "trace",
                               "--exposure", "0"], stdout=subprocess.PIPE, text=True)
    browser = None
    try:
        address = server.stdout.readline().strip()
        if not address.startswith("http://127.0.0.1:"):
            sys.exit(f"the server says {address!r}")
        # The browser's helpers outlive it for a moment, and go on writing.
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
            browser = Browser(program, profile, address)
            try:
                walk(browser, vlf, pack, work)
            finally:
                browser.process.terminate()
                browser.process.wait()
    finally:
        server.terminate()
        server.wait()


def walk(browser, vlf, pack, work):
    canvas = "document.getElementById('picture')"
    until(lambda: browser.value(f"{canvas}.dataset.pass") == "1/16", "the first picture")

    def compared(what):
        """The page's picture against `vlf render` of the camera that the page names."""
        browser.press("KeyJ")
        until(lambda: "camera:" in (browser.value("lines.textContent") or ""), "the camera")
        camera = json.loads(browser.value("lines.textContent").split("camera:", 1)[1])
        # The help on and off again: nothing is written over the picture any more.
        browser.press("F1")
        until(lambda: "full screen" in browser.value("lines.textContent"), "the help")
        browser.press("F1")
        until(lambda: browser.value("lines.textContent") == "", "the end of the help")
        shown = browser.picture()
        shown.save(work / f"{what}-browser.png")
        made = rendered(vlf, pack, camera, work / f"{what}-render.png")
        off = apart(shown, made)
        print(f"{what}: {off:.4f} of 255 apart")
        if off > CLOSE:
            sys.exit(f"{what}: the page shows another picture than vlf render makes, see {work}")
        if max(ImageStat.Stat(shown).stddev) < 5.0:
            sys.exit(f"{what}: there is nothing to see")
        return shown

    def changed(before, after, what):
        if apart(before, after) < 1.0:
            sys.exit(f"{what} changed nothing")

    first = compared("first")
    browser.key("KeyW", "keyDown")
    time.sleep(0.4)
    browser.key("KeyW", "keyUp")
    browser.settled("the picture after walking")
    walked = compared("walked")
    changed(first, walked, "walking")

    browser.mouse("mousePressed", 160, 120, True)
    for x in range(160, 200, 5):
        browser.mouse("mouseMoved", x, 120, True)
    browser.mouse("mouseReleased", 200, 120, False)
    browser.settled("the picture after dragging")
    dragged = compared("dragged")
    changed(walked, dragged, "dragging")

    browser.mouse("mousePressed", 160, 120, True)
    browser.mouse("mouseReleased", 160, 120, False)
    until(lambda: browser.value(f"document.pointerLockElement === {canvas}"), "the captured mouse")
    for x in range(160, 240, 8):
        browser.mouse("mouseMoved", x, 130, False)
    browser.settled("the picture after looking around")
    changed(dragged, compared("looked"), "the captured mouse")

    if browser.thrown:
        sys.exit("thrown in the page: " + "\n".join(browser.thrown))


main(*sys.argv[1:])

"""Walks in a window under a virtual display.

Arguments: vlf-view, vlf, a pack, and a folder for what is made.
"""

import json
import os
import pathlib
import shutil
import subprocess
import sys
import time

from common import PATIENCE, apart, until
from PIL import Image, ImageGrab, ImageStat

WIDTH, HEIGHT = 640, 480


class Window:
    """vlf-view, its window and what is seen of it."""

    def __init__(self, display, command, folder):
        self.display, self.folder = display, folder
        self.environment = dict(os.environ, DISPLAY=display, XDG_CONFIG_HOME=str(folder / "config"))
        self.environment.pop("WAYLAND_DISPLAY", None)
        self.out = folder / "standard-output"
        with open(self.out, "w") as out, open(folder / "standard-error", "w") as err:
            self.process = subprocess.Popen(command, env=self.environment, stdout=out, stderr=err)
        self.id = until(lambda: self.alive() and self.do("search", "--name", "F1 for help").split(), "the window")[-1]
        self.size = (WIDTH, HEIGHT)
        # Nobody gives the keyboard to a window where there is no window manager.
        until(lambda: self.do("windowfocus", self.id) is not None and self.do("getwindowfocus").strip() == self.id, "the keyboard")

    def do(self, *command):
        done = subprocess.run(["xdotool", *map(str, command)], env=self.environment,
                              stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        return done.stdout

    def alive(self):
        if self.process.poll() is not None:
            sys.exit(f"vlf-view has ended with {self.process.returncode}: "
                     + (self.folder / "standard-error").read_text())
        return True

    def seen(self):
        """The window's picture as it is on the screen."""
        self.alive()
        return ImageGrab.grab(xdisplay=self.display).convert("RGB").crop((0, 0, *self.size))

    def worked(self):
        """Hundredths of a second that its threads have worked."""
        stat = pathlib.Path(f"/proc/{self.process.pid}/stat").read_text().rsplit(")", 1)[1].split()
        return int(stat[11]) + int(stat[12])

    def still(self):
        """The window's picture once there is nothing left to refine: nothing works on it any more."""
        idle, end = 0, time.monotonic() + PATIENCE
        while time.monotonic() < end:
            before = self.worked()
            time.sleep(0.15)
            self.alive()
            idle = idle + 1 if self.worked() - before <= 1 else 0
            if idle == 3:
                return self.seen()
        sys.exit("the picture never stands still")

    def key(self, *keys):
        self.do("key", *keys)

    def held(self, key, seconds):
        self.do("keydown", key)
        time.sleep(seconds)
        self.do("keyup", key)

    def resize(self, width, height):
        self.do("windowsize", self.id, width, height)
        self.size = (width, height)

    def clear(self):
        """Lets nothing stand over the picture: help on and off."""
        self.key("F1")
        self.key("F1")

    def text(self):
        """How dark the ground is on which text stands in the corner; 255 without."""
        return max(self.seen().getpixel((0, 0)))


def changed(before, after, what, least=1.0):
    off = apart(before, after)
    print(f"{what}: {off:.2f} of 255 apart")
    if off < least:
        sys.exit(f"{what} changed nothing")


def same(a, b, what, most=0.0):
    off = apart(a, b)
    print(f"{what}: {off:.4f} of 255 apart")
    if off > most:
        sys.exit(f"{what}: not the same picture")


def main(view, vlf, pack, work):
    work = pathlib.Path(work)
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    read, write = os.pipe()
    screen = subprocess.Popen(["Xvfb", "-displayfd", str(write), "-screen", "0", "1280x800x24", "-nolisten", "tcp"],
                              pass_fds=[write], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    os.close(write)
    try:
        with os.fdopen(read) as told:
            number = told.readline().strip()
        if not number:
            sys.exit("Xvfb does not start")
        walk(f":{number}", view, vlf, pack, work)
        close(f":{number}", view, pack, work)
    finally:
        screen.terminate()
        screen.wait()


def begin(display, view, pack, folder, *more):
    """vlf-view on a copy of the pack, in a folder of its own."""
    folder.mkdir()
    room = folder / "room.vlf"
    shutil.copy(pack, room)
    command = [view, room, "--size", f"{WIDTH}x{HEIGHT}", "--shots", folder, *more]
    return Window(display, command, folder), room


def walk(display, view, vlf, pack, work):
    window, room = begin(display, view, pack, work / "walk", "--method", "trace",
                         "--record", work / "walked.json")
    keep = lambda picture, name: picture.save(work / f"{name}.png")
    first = window.still()
    keep(first, "1-first")
    if max(ImageStat.Stat(first).stddev) < 5.0:
        sys.exit("there is nothing to see")

    window.held("w", 0.4)
    walked = window.still()
    keep(walked, "2-walked")
    changed(first, walked, "walking")
    window.key("r")
    same(first, window.still(), "the first view again")

    window.do("mousemove", "--window", window.id, 300, 200, "mousedown", 1)
    for x in range(300, 420, 10):
        window.do("mousemove", "--window", window.id, x, 210)
    window.do("mouseup", 1)
    dragged = window.still()
    changed(first, dragged, "dragging")

    window.key("ctrl+1")
    until(lambda: (room.parent / "room.views.json").exists(), "the saved view")
    window.held("Left", 0.3)
    window.clear()
    changed(dragged, window.still(), "walking sideways")
    window.key("1")
    same(dragged, window.still(), "the saved view again")

    window.do("click", 1)
    window.clear()
    before = window.still()
    for _ in range(10):
        window.do("mousemove_relative", "--", 9, -3)
    looked = window.still()
    changed(before, looked, "the captured mouse")
    window.key("Escape")
    window.do("mousemove_relative", "--", 50, 0)
    window.clear()
    same(looked, window.still(), "the mouse let go")

    window.key("F1")
    window.key("i")
    helped = window.still()
    keep(helped, "3-help-and-figures")
    changed(looked, helped, "the help")
    window.key("i")
    window.key("F1")
    for key, what in [("plus", "more light"), ("t", "another curve"), ("m", "the difference")]:
        before = window.still()
        window.key(key)
        window.clear()
        changed(before, window.still(), what, 0.2)
    window.key("m")
    window.clear()
    keep(window.still(), "4-field")
    window.key("m", "x", "t", "t", "k", "f", "f")
    window.do("click", 4)
    window.clear()

    shot(window, vlf, room, work)
    keep(resizes(window), "5-resized")
    packs(window, room, pack, keep)

    window.do("keydown", "w")
    time.sleep(0.1)
    window.key("Escape")
    until(lambda: window.process.poll() is not None, "the end")
    if window.process.returncode != 0:
        sys.exit(f"vlf-view ended with {window.process.returncode}")
    window.do("keyup", "w")
    bench = subprocess.run([view, pack, "--bench", work / "walked.json", "--json", "--size", "64x48"],
                           check=True, stdout=subprocess.PIPE, text=True)
    figures = json.loads(bench.stdout)
    print(f"the walk again: {figures}")
    if not 0.0 < figures["median_ms"] <= figures["p95_ms"] <= figures["p99_ms"] <= figures["worst_ms"]:
        sys.exit("odd figures")


def shot(window, vlf, room, work):
    """A screenshot is what vlf render makes of the camera that is copied."""
    window.still()
    window.key("p")
    picture = room.parent / "room-0001.png"
    until(lambda: picture.exists() and picture.stat().st_size > 0, "the screenshot")
    until(lambda: (room.parent / "room-0001.exr").stat().st_size > 0, "the screenshot's radiance")
    window.key("j")
    until(lambda: window.out.read_text().endswith("}\n"), "the camera")
    camera = work / "camera.json"
    camera.write_text(window.out.read_text().splitlines()[-1])
    # What is exact for certain is the radiance; the exposure is the window's own.
    made = work / "rendered.exr"
    subprocess.run([vlf, "render", room, "-o", made, "--camera", camera, "--method", "trace"],
                   check=True, stderr=subprocess.DEVNULL)
    compared = subprocess.run([vlf, "compare", room.parent / "room-0001.exr", made, "--json"],
                              check=True, stdout=subprocess.PIPE, text=True)
    error = json.loads(compared.stdout)
    print(f"the screenshot against vlf render: {error}")
    if error["relmse"] != 0.0:
        sys.exit("the screenshot is another picture than vlf render makes")
    window.clear()
    same(window.still(), Image.open(picture).convert("RGB"), "the screenshot against the window")


def resizes(window):
    """Sizes, while a picture is being made and while there is no window to see."""
    window.do("keydown", "d")
    for width, height in [(333, 222), (1, 1), (2, 700), (900, 3), (1200, 780), (50, 50), (801, 601)]:
        window.resize(width, height)
        time.sleep(0.05)
        window.alive()
    window.do("keyup", "d")
    window.key("r")
    window.still()
    window.do("windowunmap", window.id)
    time.sleep(0.5)
    window.alive()
    window.do("windowmap", window.id)
    window.do("windowfocus", window.id)
    window.clear()
    resized = window.still()
    if max(ImageStat.Stat(resized).stddev) < 5.0:
        sys.exit("there is nothing to see after resizing")
    window.resize(WIDTH, HEIGHT)
    return resized


def packs(window, room, pack, keep):
    """The pack is replaced, taken, cut short and made whole again, while it is looked at."""
    before = window.still()
    other = room.with_name("other.vlf")
    shutil.copy(pack, other)
    other.replace(room)
    until(lambda: apart(window.seen(), before) > 0.0, "the message that the pack was replaced")
    keep(window.still(), "6-replaced")
    window.key("n")
    same(before, window.still(), "the pack that replaced it")

    with open(room, "r+b") as file:
        file.truncate(4096)
    until(lambda: apart(window.seen(), before) > 0.0, "the message that the pack was cut short")
    window.key("m", "m")
    window.held("s", 0.3)
    cut = window.still()
    keep(cut, "7-cut-short")
    magenta = sum(1 for r, g, b in cut.getdata() if r > 200 and g < 50 and b > 200)
    print(f"the pack that was cut short: {magenta} magenta pixels")
    if magenta < 1000:
        sys.exit("what needs maps that are gone is not marked")
    window.key("n")
    window.still()
    shutil.copy(pack, room)
    window.key("n")
    window.key("r")
    window.still()
    window.alive()


def close(display, view, pack, work):
    """The window is taken away in the middle of a frame."""
    window, _ = begin(display, view, pack, work / "close", "--method", "field")
    window.do("keydown", "w")
    time.sleep(0.5)
    window.do("windowclose", window.id)
    until(lambda: window.process.poll() is not None, "the end of vlf-view without its window")
    said = (window.folder / "standard-error").read_text()
    print(f"the window taken away: {window.process.returncode} {said!r}")
    if "panicked" in said or window.process.returncode < 0:
        sys.exit("vlf-view crashed when its window was taken away")


main(*sys.argv[1:])

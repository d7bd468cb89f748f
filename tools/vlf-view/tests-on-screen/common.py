"""What both walks need: waiting with patience, and how far pictures are apart."""

import sys
import time

from PIL import ImageChops, ImageStat

PATIENCE = 60.0


def until(true, what):
    """Waits for something, and returns it."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        found = true()
        if found:
            return found
        time.sleep(0.05)
    sys.exit(f"waited for {what} in vain")


def apart(a, b):
    """Mean absolute difference over pixels and channels, of 255."""
    if a.size != b.size:
        return 255.0
    return sum(ImageStat.Stat(ImageChops.difference(a, b)).mean) / 3.0

#!/usr/bin/env python3
"""Writes the gallery: a room with a mosaic floor and two paintings, which are images, and a mirror across from them.

Needs Python 3 only. Writes gallery.obj, gallery.mtl and the PNG files beside this file.
"""

import math
import struct
import zlib
from pathlib import Path

HERE = Path(__file__).resolve().parent


def png(name, width, height, colour):
    """Writes an image: `colour(x, y)` in [0, 1]^2 from the lower left gives sRGB in [0, 1]."""

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    rows = b""
    for row in range(height):
        rows += b"\0"
        for column in range(width):
            rgb = colour((column + 0.5) / width, 1 - (row + 0.5) / height)
            rows += bytes(round(255 * min(max(c, 0), 1)) for c in rgb)
    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    data = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows, 9)) + chunk(b"IEND", b"")
    (HERE / name).write_bytes(b"\x89PNG\r\n\x1a\n" + data)


def mosaic(x, y):
    """Four by four stones of three kinds, with joints."""
    column, row = int(4 * x), int(4 * y)
    u, v = 4 * x - column, 4 * y - row
    if min(u, v, 1 - u, 1 - v) < 0.04:
        return 0.32, 0.30, 0.28
    if (u - 0.5) ** 2 + (v - 0.5) ** 2 < 0.06:
        return 0.62, 0.24, 0.18
    return (0.80, 0.76, 0.68) if (column + row) % 2 else (0.30, 0.40, 0.46)


def sunset(x, y):
    """A sun over the sea."""
    if y < 0.4:
        glint = math.exp(-((x - 0.6) ** 2) / 0.008) * (0.5 + 0.5 * math.sin(90 * y))
        return 0.16 + 0.7 * glint, 0.24 + 0.4 * glint, 0.42 + 0.1 * glint
    if (1.5 * (x - 0.6)) ** 2 + (y - 0.52) ** 2 < 0.012:
        return 1.0, 0.86, 0.45
    up = (y - 0.4) / 0.6
    return 0.95 - 0.6 * up, 0.55 - 0.22 * up, 0.35 + 0.25 * up


def squares(x, y):
    """Fields of plain colours."""
    if min(abs(x - 0.3), abs(y - 0.65), abs(y - 0.2) + (x < 0.3)) < 0.02:
        return 0.06, 0.06, 0.07
    if x < 0.3:
        return (0.83, 0.15, 0.12) if y > 0.65 else (0.93, 0.91, 0.86)
    if y > 0.65:
        return 0.94, 0.92, 0.87
    return (0.95, 0.80, 0.20) if y < 0.2 else (0.14, 0.25, 0.56)


corners, places, faces = [], [], []


def quad(material, points, uv=None):
    """Counter-clockwise as seen from the front."""
    first = len(corners) + 1
    corners.extend(points)
    ends = [str(first + k) for k in range(4)]
    if uv:
        ends = [f"{end}/{len(places) + 1 + k}" for k, end in enumerate(ends)]
        places.extend(uv)
    faces.append((material, " ".join(ends)))


def box(material, low, high):
    (a, b, c), (d, e, f) = low, high
    quad(material, [(a, e, c), (a, e, f), (d, e, f), (d, e, c)])
    quad(material, [(a, b, f), (d, b, f), (d, e, f), (a, e, f)])
    quad(material, [(d, b, c), (a, b, c), (a, e, c), (d, e, c)])
    quad(material, [(d, b, f), (d, b, c), (d, e, c), (d, e, f)])
    quad(material, [(a, b, c), (a, b, f), (a, e, f), (a, e, c)])


def painting(material, x, y, width, height):
    """A frame with a picture in it, a hand before the wall z = 0."""
    box("frame", (x - 0.06, y - 0.06, 0.0), (x + width + 0.06, y + height + 0.06, 0.04))
    at = [(x, y, 0.045), (x + width, y, 0.045), (x + width, y + height, 0.045), (x, y + height, 0.045)]
    quad(material, at, [(0, 0), (1, 0), (1, 1), (0, 1)])


W, H, D = 6.0, 3.0, 4.0
tiled = [(0, 0), (0, D / 2), (W / 2, D / 2), (W / 2, 0)]
quad("mosaic", [(0, 0, 0), (0, 0, D), (W, 0, D), (W, 0, 0)], tiled)
quad("plaster", [(0, H, 0), (W, H, 0), (W, H, D), (0, H, D)])
quad("plaster", [(0, 0, 0), (W, 0, 0), (W, H, 0), (0, H, 0)])
quad("plaster", [(W, 0, D), (0, 0, D), (0, H, D), (W, H, D)])
quad("plaster", [(0, 0, D), (0, 0, 0), (0, H, 0), (0, H, D)])
quad("plaster", [(W, 0, 0), (W, 0, D), (W, H, D), (W, H, 0)])
painting("sunset", 0.9, 1.1, 1.8, 1.2)
painting("squares", 3.7, 1.0, 1.4, 1.4)
quad("mirror", [(4.6, 0.4, D - 0.02), (1.4, 0.4, D - 0.02), (1.4, 2.4, D - 0.02), (4.6, 2.4, D - 0.02)])
quad("lamp", [(2.0, H - 0.02, 1.6), (4.0, H - 0.02, 1.6), (4.0, H - 0.02, 2.4), (2.0, H - 0.02, 2.4)])
box("bench", (2.2, 0.0, 2.1), (3.8, 0.42, 2.6))

png("mosaic.png", 256, 256, mosaic)
png("sunset.png", 192, 128, sunset)
png("squares.png", 128, 128, squares)

lines = ["# The gallery, by make.py", "mtllib gallery.mtl"]
lines += [f"v {x:g} {y:g} {z:g}" for x, y, z in corners]
lines += [f"vt {u:g} {v:g}" for u, v in places]
for material, ends in faces:
    lines += [f"usemtl {material}", f"f {ends}"]
(HERE / "gallery.obj").write_text("\n".join(lines) + "\n")
(HERE / "gallery.mtl").write_text("""# The gallery, by make.py
newmtl mosaic
Kd 1 1 1
map_Kd mosaic.png
newmtl sunset
Kd 1 1 1
map_Kd sunset.png
newmtl squares
Kd 1 1 1
map_Kd squares.png
newmtl plaster
Kd 0.75 0.73 0.7
newmtl frame
Kd 0.25 0.16 0.08
newmtl bench
Kd 0.45 0.3 0.18
newmtl mirror
Kd 0 0 0
Ks 0.9 0.9 0.9
illum 3
newmtl lamp
Kd 0.8 0.8 0.8
Ke 10 9.4 8.4
""")

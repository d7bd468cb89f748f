#!/usr/bin/env python3
"""Writes torture.obj beside itself: a closed room of things that real models have and that rays dislike.

Coordinates are exact where surfaces touch. The order of the polygons matters: one poster stands before
the wall that it hangs on, the others after theirs."""

import math
from pathlib import Path

lines = ["mtllib torture.mtl"]


def polygon(material, *corners):
    """A polygon, counter-clockwise from its front."""
    lines.extend(f"v {x:.7g} {y:.7g} {z:.7g}" for x, y, z in corners)
    lines.append(f"usemtl {material}\nf " + " ".join(str(k - len(corners)) for k in range(len(corners))))


def box(material, low, high, bottom=True):
    """A box, its fronts outside."""
    (a, b, c), (d, e, f) = low, high
    polygon(material, (a, b, c), (a, b, f), (a, e, f), (a, e, c))
    polygon(material, (d, b, f), (d, b, c), (d, e, c), (d, e, f))
    if bottom:
        polygon(material, (a, b, c), (d, b, c), (d, b, f), (a, b, f))
    polygon(material, (a, e, f), (d, e, f), (d, e, c), (a, e, c))
    polygon(material, (d, b, c), (a, b, c), (a, e, c), (d, e, c))
    polygon(material, (a, b, f), (d, b, f), (d, e, f), (a, e, f))


def on_back(material, x0, x1, z):
    """A poster before the back wall, which is z = -1."""
    polygon(material, (x0, 0.1, z), (x1, 0.1, z), (x1, 0.6, z), (x0, 0.6, z))


def on_right(x, z0, z1, material):
    """A strip of the right wall, which is x = 1 and faces -x."""
    polygon(material, (x, -1, z0), (x, -1, z1), (x, 1, z1), (x, 1, z0))


# A poster exactly on the back wall, before the wall in this file; after it another, and one that is
# nearer to the eye than the wall by less than a float of the far side of the room can tell.
on_back("poster_first", -0.9, -0.5, -1)
polygon("back", (-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1))
on_back("poster_last", -0.2, 0.2, -1)
on_back("poster_near", 0.5, 0.9, -1 + 1e-6)

# A floor with T-junctions: one half, and three pieces of the other whose corners lie on its edge. Different
# materials, so that nothing merges.
polygon("floor_a", (-1, -1, 1), (0, -1, 1), (0, -1, -1), (-1, -1, -1))
polygon("floor_b", (0, -1, 1), (1, -1, 1), (1, -1, 0.37), (0, -1, 0.37))
polygon("floor_a", (0, -1, 0.37), (1, -1, 0.37), (1, -1, -0.21), (0, -1, -0.21))
polygon("floor_b", (0, -1, -0.21), (1, -1, -0.21), (1, -1, -1), (0, -1, -1))

# The right wall has slivers in it: strips of 1e-4 and 1e-5, and triangles as long as the wall and 1e-3 wide.
on_right(1, -1, 0.3, "wall")
on_right(1, 0.3, 0.3001, "sliver")
on_right(1, 0.3001, 0.5, "wall_b")
on_right(1, 0.5, 0.50001, "sliver")
on_right(1, 0.50001, 0.7, "wall")
polygon("sliver", (1, -1, 0.7), (1, -1, 0.701), (1, 1, 0.7))
polygon("wall_b", (1, -1, 0.701), (1, 1, 0.701), (1, 1, 0.7))
on_right(1, 0.701, 1, "wall")

# The left wall, with a mirror exactly on it; ceiling and front.
polygon("wall", (-1, -1, 1), (-1, -1, -1), (-1, 1, -1), (-1, 1, 1))
polygon("mirror", (-1, -0.6, 0.2), (-1, -0.6, -0.6), (-1, 0.5, -0.6), (-1, 0.5, 0.2))
polygon("wall_b", (-1, 1, -1), (1, 1, -1), (1, 1, 1), (-1, 1, 1))
polygon("wall", (1, -1, 1), (-1, -1, 1), (-1, 1, 1), (1, 1, 1))

# The lamp, and at its back a panel that touches it.
polygon("lamp", (-0.3, 0.95, -0.3), (0.3, 0.95, -0.3), (0.3, 0.95, 0.3), (-0.3, 0.95, 0.3))
polygon("wall_b", (-0.3, 0.95, 0.3), (0.3, 0.95, 0.3), (0.3, 0.95, -0.3), (-0.3, 0.95, -0.3))

# Two boxes on the floor that stand in each other, one with its bottom in the floor's plane.
box("solid", (-0.75, -1, -0.75), (-0.3, -0.5, -0.3))
cos, sin = math.cos(0.5), math.sin(0.5)


def turned(x, z):
    """A corner of the second box, about its middle."""
    return -0.35 + cos * x - sin * z, -0.3 + sin * x + cos * z


low, high = -1, -0.65
corners = [turned(x, z) for x, z in [(-0.2, 0.2), (0.2, 0.2), (0.2, -0.2), (-0.2, -0.2)]]
polygon("solid_b", *[(x, high, z) for x, z in corners])
polygon("solid_b", *[(x, low, z) for x, z in reversed(corners)])
for (x0, z0), (x1, z1) in zip(corners, corners[1:] + corners[:1]):
    polygon("solid_b", (x0, low, z0), (x1, low, z1), (x1, high, z1), (x0, high, z0))

# A table whose legs are far thinner than a cell, and crumbs on it that are smaller than one.
box("table", (0.2, -0.62, -0.7), (0.8, -0.6, -0.3))
for x in (0.21, 0.778):
    for z in (-0.69, -0.322):
        box("leg", (x, -1, z), (x + 0.012, -0.62, z + 0.012))
for k in range(6):
    x, z = 0.3 + 0.07 * k, -0.5 + 0.03 * (k % 3)
    box("crumb", (x, -0.6, z), (x + 0.004, -0.596, z + 0.004))

# A fan of blades about an upright axis: axis-parallel and diagonal ones are edge-on to lines of the lattice.
for k in range(8):
    angle = k * math.pi / 4
    x, z = 0.4 + 0.25 * math.cos(angle), 0.35 + 0.25 * math.sin(angle)
    polygon("blade", (0.4, -0.95, 0.35), (x, -0.95, z), (x, -0.55, z), (0.4, -0.55, 0.35))

Path(__file__).with_name("torture.obj").write_text("\n".join(lines) + "\n")

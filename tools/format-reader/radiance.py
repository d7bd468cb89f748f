"""Looks radiance up in a pack, as the README's sections Lines, Parallel subfields and Radiance say.

A `File` of kind pack, a surface, a point of the unit ball and a direction in; linear RGB out.
"""

import math
import struct

from reader import Kind, dot, f32, grid, is_mirror, mask_of, minus
from vlf import Vlf


def sign(number):
    return -1 if number < 0 else 1


class Lines:
    """The lattice of l directions: their vectors, and the line and sense of each grid point."""

    def __init__(self, count):
        self.q = q = math.isqrt((count - 1) // 2)
        self.vectors = []
        self.named = {}
        for y in range(-q, q + 1):
            for x in range(-q, q + 1):
                if abs(x) + abs(y) > q or (x, y) in self.named:
                    continue
                opposite = ((q - abs(y)) * -sign(x), (q - abs(x)) * -sign(y))
                for point, sense in ((x, y), 0), (opposite, 1):
                    for same in self.same_vector(*point):
                        self.named[same] = (len(self.vectors), sense)
                self.vectors.append([f32(c) for c in self.vector(x, y)])
        assert len(self.vectors) == count and len(self.named) == (2 * q + 1) ** 2

    def same_vector(self, x, y):
        across_x = [-x, x] if abs(y) == self.q else [x]
        across_y = [-y, y] if abs(x) == self.q else [y]
        return [(a, b) for a in across_x for b in across_y]

    def vector(self, x, y):
        a, b = abs(x) / self.q, abs(y) / self.q
        r = 1 - abs(1 - (a + b))
        phi = math.pi / 4 * ((b - a) / r + 1 if r > 0 else 1)
        s = r * math.sqrt(2 - r * r)
        z = (1 - r * r) * (1 if a + b <= 1 else -1)
        return sign(x) * math.cos(phi) * s, sign(y) * math.sin(phi) * s, z

    def nearest(self, d):
        """Three lines with the sense and the weight of each."""
        q = self.q
        r = math.sqrt(max(0, 1 - abs(d[2])))
        p = math.atan2(abs(d[1]), abs(d[0])) / (math.pi / 2)
        a, b = (r - p * r, p * r) if d[2] >= 0 else (1 - p * r, 1 - r + p * r)
        x, y = sign(d[0]) * a * q, sign(d[1]) * b * q
        x0, y0 = (min(max(math.floor(c), -q), q - 1) for c in (x, y))
        fx, fy = x - x0, y - y0
        if (x0 < 0) == (y0 < 0):
            if fx + fy <= 1:
                corners = (0, 0, 1 - fx - fy), (1, 0, fx), (0, 1, fy)
            else:
                corners = (1, 1, fx + fy - 1), (0, 1, 1 - fx), (1, 0, 1 - fy)
        elif fx >= fy:
            corners = (0, 0, 1 - fx), (1, 0, fx - fy), (1, 1, fy)
        else:
            corners = (0, 0, 1 - fy), (0, 1, fy - fx), (1, 1, fx)
        return [(*self.named[x0 + i, y0 + j], weight) for i, j, weight in corners]


def axes(w):
    """Right and up of a line's parallel subfield."""
    g = math.copysign(1, w[2])
    a = f32(-1 / f32(g + w[2]))
    b = f32(f32(w[0] * w[1]) * a)
    right = (f32(1 + f32(f32(g * w[0] * w[0]) * a)), g * b, -g * w[0])
    up = (b, f32(g + f32(f32(w[1] * w[1]) * a)), -w[1])
    return right, up


class Pack:
    """A packed field to look radiance up in."""

    def __init__(self, file):
        self.block = file.block
        self.record, self.scene = file.content(Kind.record), file.content(Kind.scene)
        self.textures = file.content(Kind.total_textures)
        totals = [c for c in file.chunks if c.entry.kind == Kind.total_tiles]
        self.maps = {c.entry.direction: c.content for c in totals}
        self.lines = Lines(self.block.num_directions)

    def radiance(self, surface, point, away):
        """Radiance that leaves a surface at a point in a direction, W sr^-1 m^-2."""
        plane = self.scene.surfaces[surface]
        normal = plane.normal.xyz
        front = dot(away, normal) >= 0
        faced = normal if front else [-c for c in normal]
        mirror = is_mirror(self.scene, surface)
        # The light that a mirror sends along `away` comes from here.
        source = minus([2 * dot(away, normal) * c for c in normal], away) if mirror else away
        rgb = self.blended(surface, point, source, faced)
        if mirror:
            material = self.scene.materials[plane.material]
            emitted = material.emitted if front else [0, 0, 0]
            rgb = rgb or [0, 0, 0]
            return [e + f * c for e, f, c in zip(emitted, material.reflectance, rgb)]
        return rgb or self.texture(surface, point, 0 if front else 1)

    def blended(self, surface, point, direction, faced):
        """Of the nearest three lines, those that face the side and show the surface."""
        total, weights = [0, 0, 0], 0
        for line, sense, weight in self.lines.nearest(direction):
            facing = dot(self.lines.vectors[line], faced) * (-1 if sense else 1)
            rgb = self.interpolated(surface, point, line, sense) if facing > 0 else None
            if rgb and weight > 0:
                total = [t + weight * c for t, c in zip(total, rgb)]
                weights += weight
        return [t / weights for t in total] if weights > 0 else None

    def interpolated(self, surface, point, line, sense):
        """Between the middles of the four cells around a point, as far as they are covered."""
        half = self.block.resolution / 2
        x, y = ((dot(point, axis) + 1) * half - 0.5 for axis in axes(self.lines.vectors[line]))
        i, j = math.floor(x), math.floor(y)
        total, weights = [0, 0, 0], 0
        for column, part_x in (i, 1 - (x - i)), (i + 1, x - i):
            for row, part_y in (j, 1 - (y - j)), (j + 1, y - j):
                rgb = self.cell(line, surface, column, row, sense)
                if rgb:
                    total = [t + part_x * part_y * c for t, c in zip(total, rgb)]
                    weights += part_x * part_y
        return [t / weights for t in total] if weights > 0 else None

    def cell(self, line, surface, i, j, sense):
        """Radiance of a surface in a cell, None where the cell's ray does not meet it."""
        tiles, m, n = self.maps[line], self.block.tile, self.block.resolution
        if not (0 <= i < n and 0 <= j < n):
            return None
        k, b = j // m * tiles.num_columns + i // m, j % m * m + i % m
        for e in range(tiles.first[k], tiles.first[k + 1]):
            mask = mask_of(tiles, e)
            if tiles.surface[e] != surface or not mask >> b & 1:
                continue
            slot = 2 * e + sense
            if tiles.state[slot] == Vlf.State.textured:
                return self.textured(line, surface, i, j, sense)
            if tiles.state[slot] == Vlf.State.dark:
                return [0, 0, 0]
            value = tiles.value[slot]
            if tiles.state[slot] == Vlf.State.one_value_a_cell:
                value += (mask & (1 << b) - 1).bit_count()
            halves = struct.pack("<3H", *tiles.rgb[3 * value : 3 * value + 3])
            return [c * 2.0**self.block.exponent for c in struct.unpack("<3e", halves)]
        return None

    def textured(self, line, surface, i, j, sense):
        """What the texture map has where a cell's middle ray meets a surface, as an f16."""
        plane, w = self.scene.surfaces[surface], self.lines.vectors[line]
        normal, edge = plane.normal.xyz, 2 / self.block.resolution
        places = ((i + 0.5) * edge - 1, (j + 0.5) * edge - 1)
        flat = [sum(axis[c] * at for axis, at in zip(axes(w), places)) for c in range(3)]
        depth = (dot(normal, plane.origin.xyz) - dot(normal, flat)) / dot(normal, w)
        point = [f + depth * c for f, c in zip(flat, w)]
        front = (dot(normal, w) > 0) == (sense == 0)
        scale = 2.0**self.block.exponent
        rgb = [c / scale for c in self.texture(surface, point, 0 if front else 1)]
        return [c * scale for c in struct.unpack("<3e", struct.pack("<3e", *rgb))]

    def texture(self, surface, point, side):
        """The texture map, bilinear between the middles of texels."""
        plane = self.scene.surfaces[surface]
        columns, rows = grid(self.scene, self.record, surface)
        before = [s for s in range(surface) if not is_mirror(self.scene, s)]
        first = sum(math.prod(grid(self.scene, self.record, s)) for s in before)
        from_origin = minus(point, plane.origin.xyz)
        total = [0, 0, 0]
        along = []
        for axis, extent, count in zip((plane.u, plane.v), plane.extent, (columns, rows)):
            at = dot(from_origin, axis.xyz) / extent * count - 0.5
            at = min(max(at, 0), count - 1)
            low = min(math.floor(at), max(count - 2, 0))
            along.append([(low, 1 - (at - low)), (min(low + 1, count - 1), at - low)])
        for column, part_x in along[0]:
            for row, part_y in along[1]:
                rgb = self.textures.values[2 * (first + row * columns + column) + side].channels
                total = [t + part_x * part_y * c for t, c in zip(total, rgb)]
        return total

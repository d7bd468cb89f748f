"""Puts the planes of a tile map together again, as the README's section Planes says."""

import struct
from itertools import accumulate


def from_planes(data):
    """The bytes of the map. ValueError where the numbers contradict each other."""
    n, m, entries, values, step = struct.unpack_from("<4IH", data)
    rest = memoryview(data)[18:]
    words = -(-m * m // 64)
    if len(rest) != 4 * n * n + (8 * words + 6) * entries + 6 * values or m * step == 0:
        raise ValueError(f"{len(data)} bytes for {entries} entries and {values} values")

    def take(size):
        nonlocal rest
        taken, rest = rest[:size], rest[size:]
        return taken

    def planes(count, number):
        parts = [take(number) for _ in range(count)]
        return [sum(part[i] << 8 * k for k, part in enumerate(parts)) for i in range(number)]

    counts = planes(4, n * n)
    if sum(counts) != entries:
        raise ValueError(f"tiles have {sum(counts)} entries, not {entries}")
    first = list(accumulate(counts, initial=0))
    numbers = iter(planes(4, entries))
    surfaces = []
    for count in counts:
        least = 0
        for _ in range(count):
            surfaces.append((least + next(numbers)) % 2**32)
            least = surfaces[-1] + 1
    along, against = take(entries), take(entries)
    states = [state for both in zip(along, against) for state in both]
    row = m // 8 if m % 8 == 0 else 1
    masks = [bytearray(8 * words) for _ in range(entries)]
    for k in range(8 * words):
        for mask, byte in zip(masks, take(entries)):
            mask[k] = byte ^ (mask[k - row] if k >= row else 0)
    covered = [cells_of(mask) for mask in masks]
    cells = [{0: [], 1: [0], 2: covered[s // 2], 3: []}.get(state, []) for s, state in enumerate(states)]
    starts = list(accumulate(map(len, cells), initial=0))
    if starts.pop() != values:
        raise ValueError(f"slots have another number of values than {values}")
    rgb = [c * step % 2**16 for c in channels([planes(2, values) for _ in range(3)], cells, m)]

    out = bytearray(struct.pack("<4I", n, m, entries, values))
    for form, table in ("I", first), ("I", surfaces), ("I", starts), ("B", states):
        out += struct.pack(f"<{len(table)}{form}", *table)
        out += bytes(-len(out) % 8)
    out += b"".join(masks) + struct.pack(f"<{len(rgb)}H", *rgb)
    return bytes(out + bytes(-len(out) % 8))


def cells_of(mask):
    return [8 * k + bit for k, byte in enumerate(mask) for bit in range(8) if byte >> bit & 1]


def channels(differences, cells, m):
    """Three numbers a value, of what they differ by from the expected."""
    folded = zip(*differences)
    last = [0, 0, 0]
    out = []
    for slot in cells:
        known = {}
        for cell in slot:
            x, y = cell % m, cell // m
            left, above, corner = (known.get(at) for at in ((x - 1, y), (x, y - 1), (x - 1, y - 1)))
            if left and above and corner:
                sorts = [sorted((a, b, a + b - c)) for a, b, c in zip(left, above, corner)]
                expected = [middle for _, middle, _ in sorts]
            else:
                expected = left or above or last
            r, g, b = (d // 2 if d % 2 == 0 else -(d + 1) // 2 for d in next(folded))
            moved = (e + d for e, d in zip(expected, (r, g + r, b + r)))
            last = [(v + 2**15) % 2**16 - 2**15 for v in moved]
            known[x, y] = last
            out += last
    return out

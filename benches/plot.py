"""Curves on logarithmic axes as SVG, without a library."""

import math
from html import escape

WIDTH, HEIGHT = 460, 320
LEFT, RIGHT, TOP, BOTTOM = 70, 16, 34, 50
# Okabe and Ito 2008: told apart by all eyes. Marks differ too.
COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#888888"]
MARKS = ["circle", "square", "diamond", "triangle"]


class Panel:
    """One pair of axes. Curves are pairs of a name and points (x, y), all positive; `floor` is a value
    of y to mark."""

    def __init__(self, title, x_label, y_label, curves, floor=None):
        self.title, self.x_label, self.y_label, self.floor = title, x_label, y_label, floor
        self.curves = [(name, sorted(points)) for name, points in curves]

    def spans(self):
        """The ranges of x and y in powers of ten, with room about the points."""
        points = [p for _, curve in self.curves for p in curve]
        ys = [y for _, y in points] + ([self.floor] if self.floor else [])
        return span([x for x, _ in points]), span(ys)


def span(values):
    """The logarithms of the least and the greatest, a little farther apart."""
    low, high = math.log10(min(values)), math.log10(max(values))
    room = max(0.06 * (high - low), 0.05)
    return low - room, high + room


def svg(panels, columns):
    """The panels in rows, a legend below."""
    names = list(dict.fromkeys(name for panel in panels for name, _ in panel.curves))
    rows = math.ceil(len(panels) / columns)
    width, height = columns * WIDTH, rows * HEIGHT + 24 + 20 * len(names)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
        f'viewBox="0 0 {width} {height}" font-family="sans-serif" font-size="12">',
        f'<rect width="{width}" height="{height}" fill="white"/>',
    ]
    for at, panel in enumerate(panels):
        parts.append(f'<g transform="translate({at % columns * WIDTH} {at // columns * HEIGHT})">')
        parts += draw(panel, names)
        parts.append("</g>")
    for at, name in enumerate(names):
        y = rows * HEIGHT + 20 + 20 * at
        colour = COLOURS[at % len(COLOURS)]
        parts.append(line(LEFT, y, LEFT + 36, y, colour, 2))
        parts.append(mark(LEFT + 18, y, at))
        parts.append(text(LEFT + 46, y + 4, name, "start"))
    return "\n".join(parts) + "\n</svg>\n"


def draw(panel, names):
    """One panel at the origin."""
    (x0, x1), (y0, y1) = panel.spans()
    right, bottom = WIDTH - RIGHT, HEIGHT - BOTTOM

    def place(x, y):
        across = (math.log10(x) - x0) / (x1 - x0)
        up = (math.log10(y) - y0) / (y1 - y0)
        return LEFT + across * (right - LEFT), bottom - up * (bottom - TOP)

    parts = [text((LEFT + right) / 2, TOP - 12, panel.title, "middle", "bold")]
    for value, is_labelled in ticks(x0, x1):
        x, _ = place(value, 10**y0)
        parts.append(line(x, TOP, x, bottom, "#ccc" if is_labelled else "#eee", 1))
        if is_labelled:
            parts.append(text(x, bottom + 17, short(value), "middle"))
    for value, is_labelled in ticks(y0, y1):
        _, y = place(10**x0, value)
        parts.append(line(LEFT, y, right, y, "#ccc" if is_labelled else "#eee", 1))
        if is_labelled:
            parts.append(text(LEFT - 6, y + 4, short(value), "end"))
    parts.append(
        f'<rect x="{LEFT}" y="{TOP}" width="{right - LEFT}" height="{bottom - TOP}" '
        'fill="none" stroke="#444"/>'
    )
    parts.append(text((LEFT + right) / 2, HEIGHT - 12, panel.x_label, "middle"))
    middle = (TOP + bottom) / 2
    parts.append(f'<g transform="rotate(-90 16 {middle})">{text(16, middle, panel.y_label, "middle")}</g>')
    if panel.floor:
        _, y = place(10**x0, panel.floor)
        parts.append(line(LEFT, y, right, y, "#444", 1, ' stroke-dasharray="5 4"'))
    for name, curve in panel.curves:
        at = names.index(name)
        places = [place(x, y) for x, y in curve]
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in places)
        colour = COLOURS[at % len(COLOURS)]
        parts.append(f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="2"/>')
        parts += [mark(x, y, at) for x, y in places]
    return parts


def ticks(low, high):
    """Values between two powers of ten for lines of a grid, and whether they get a label."""
    is_short = high - low < 1.5
    for power in range(math.floor(low), math.ceil(high) + 1):
        for digit in range(1, 10):
            value = digit * 10.0**power
            if low <= math.log10(value) <= high:
                yield value, digit == 1 or is_short and digit in (2, 5)


def short(value):
    """A number for an axis."""
    if 0.01 <= value < 10_000:
        return f"{value:g}"
    mantissa, power = f"{value:.0e}".split("e")
    return f"{mantissa}e{int(power)}"


def mark(x, y, at):
    """A mark of the curve with this number."""
    colour, kind = COLOURS[at % len(COLOURS)], MARKS[at % len(MARKS)]
    if kind == "circle":
        return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="{colour}"/>'
    corners = {
        "square": [(-4, -4), (4, -4), (4, 4), (-4, 4)],
        "diamond": [(0, -5), (5, 0), (0, 5), (-5, 0)],
        "triangle": [(0, -5), (5, 4), (-5, 4)],
    }[kind]
    points = " ".join(f"{x + i:.1f},{y + j:.1f}" for i, j in corners)
    return f'<polygon points="{points}" fill="{colour}"/>'


def line(x0, y0, x1, y1, colour, width, more=""):
    """A straight line."""
    where = f'x1="{x0:.1f}" y1="{y0:.1f}" x2="{x1:.1f}" y2="{y1:.1f}"'
    return f'<line {where} stroke="{colour}" stroke-width="{width}"{more}/>'


def text(x, y, words, anchor, weight="normal"):
    """A line of words."""
    where = f'x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" font-weight="{weight}"'
    return f"<text {where}>{escape(words)}</text>"

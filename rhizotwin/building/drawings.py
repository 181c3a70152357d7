"""Dimensioned drawings of printed parts and of the complete rig."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold

from rhizotwin.building.line_drawing import CORNER, FRONT, RIGHT, TOP, Drawn, draw
from rhizotwin.building.part import Dimension, Part, surface
from rhizotwin.building.rig_parts import Bought
from rhizotwin.drawing.shading import Side
from rhizotwin.rig.printing.print_page import Line, Page, Strokes, Text
from rhizotwin.rig.printing.print_page import Part as Ink
from rhizotwin.scenes.frames import Array

PAGE_MM = (297.0, 210.0)
"""Width and height of a page (A4 landscape)."""
MARGIN_MM = 8.0
TABLE_WIDE_MM = 92.0
"""Width of the table of parameters on the right of a page."""
SCALES = (2.0, 1.0, 0.5, 0.4, 0.25, 0.2, 0.1, 0.05, 0.025, 0.02, 0.01)
"""Standard drawing scales, as ratios of drawing to object."""
ROOM_MM = 15.0
"""Margin around each view, which contains the dimension lines."""
ROW_MM = 4.2
"""Spacing of dimension lines, and of the rows of the table."""
HEAVY_MM, LIGHT_MM = 0.25, 0.1
ARROW_MM = 1.6
LETTER_MM = 1.7


@dataclass(frozen=True, kw_only=True)
class _View:
    """View of a part on a page.

    The position on the page is corner + scale * (right, -up), where right and up are measured in the view from the
    lower left corner of the part's bounding box.
    """

    side: Side
    drawn: Drawn
    scale: float
    corner_mm: Array

    def at(self, point_mm: Array) -> Array:
        """Return the page position (2,) of a point (3,) of the part."""
        return self.on_page((self.side.axes @ point_mm)[:2])

    def on_page(self, points_mm: Array) -> Array:
        """Return the page positions (..., 2) of points (..., 2) in a view.

        The coordinates of the points in the view are right and up.
        """
        return np.asarray(self.corner_mm + self.scale * (points_mm - self.drawn.low_mm) * np.array([1.0, -1.0]))


def part_page(part: Part, *, title: str) -> Page:
    """Draw a part on a page with dimensions and a table of parameters.

    The part is shown from the front, from the right, from above, and in an axonometric view.
    """
    drawn = {side.name: draw(part.solid, side) for side in (FRONT, RIGHT, TOP, CORNER)}
    cell = (np.array(PAGE_MM) - [TABLE_WIDE_MM + MARGIN_MM, 2.0 * MARGIN_MM]) / 2.0
    largest = np.max([one.size_mm for one in drawn.values()], axis=0)
    fits = [scale for scale in SCALES if (scale * largest <= cell - 2.0 * ROOM_MM).all()]
    scale = max(fits, default=SCALES[-1])
    parts: list[Ink] = []
    for row, sides in enumerate(((FRONT, RIGHT), (TOP, CORNER))):
        for column, side in enumerate(sides):
            middle = np.array([MARGIN_MM, MARGIN_MM]) + cell * (np.array([column, row]) + 0.5)
            size = scale * drawn[side.name].size_mm
            view = _View(side=side, drawn=drawn[side.name], scale=scale, corner_mm=middle + size * np.array([-0.5, 0.5]))
            parts += _view(view, part.dimensions if side is not CORNER else (), overall=side is not CORNER)
    parts += _table(part, title=title, scale=scale)
    return Page(size_mm=PAGE_MM, parts=tuple(parts))


def _view(view: _View, dimensions: Sequence[Dimension], *, overall: bool, stroke_mm: float = HEAVY_MM) -> list[Ink]:
    parts: list[Ink] = [Strokes(lines_mm=tuple(view.on_page(line) for line in view.drawn.strokes_mm), width_mm=stroke_mm)]
    low, high = view.drawn.low_mm, view.drawn.high_mm
    left, bottom = view.on_page(low)
    right, top = view.on_page(high)
    parts.append(
        Text(at_mm=(float(left + right) / 2.0, float(bottom) + ROOM_MM - 1.0), text=view.side.name, height_mm=LETTER_MM, align="center")
    )
    if overall:
        parts += _across(left, right, bottom + 5.0, from_y=(bottom, bottom), value=float(high[0] - low[0]))
        parts += _up(bottom, top, left - 5.0, from_x=(left, left), value=float(high[1] - low[1]))
    rows = {"across": 0, "up": 0}
    for dimension in dimensions:
        way = _way(dimension, view.side)
        if way is None:
            continue
        a, b = (view.at(np.array(end)) for end in (dimension.from_mm, dimension.to_mm))
        if way == "across":
            y = top - 4.0 - ROW_MM * rows[way]
            parts += _across(a[0], b[0], y, from_y=(a[1], b[1]), value=_length(dimension), name=dimension.name)
        else:
            x = right + 4.0 + ROW_MM * rows[way]
            parts += _up(a[1], b[1], x, from_x=(a[0], b[0]), value=_length(dimension), name=dimension.name)
        rows[way] += 1
    return parts


def _length(dimension: Dimension) -> float:
    return float(np.linalg.norm(np.subtract(dimension.to_mm, dimension.from_mm)))


def _way(dimension: Dimension, side: Side) -> str | None:
    """Return the direction of a dimension line in a view: "across", "up", or None if it is not drawn in this view.

    Each dimension is drawn once, in the first view (front, right, above) in which its line has the true length.
    """
    for one in (FRONT, RIGHT, TOP):
        along = one.axes @ np.subtract(dimension.to_mm, dimension.from_mm)
        way = {0: "across", 1: "up"}.get(int(np.argmax(np.abs(along))))
        if way is not None and np.isclose(np.abs(along).max(), _length(dimension)):
            return way if one is side else None
    return None


def _across(x0: float, x1: float, y: float, *, from_y: tuple[float, float], value: float, name: str = "") -> list[Ink]:
    """Draw a horizontal dimension line with extension lines, arrows and value."""
    parts: list[Ink] = [_line((x, start), (x, y + np.sign(y - start) * 1.0)) for x, start in zip((x0, x1), from_y, strict=True)]
    parts += [_line((x0, y), (x1, y)), *_arrows((x0, y), (x1, y))]
    text = f"{name} {value:.2f}".strip()
    return [*parts, Text(at_mm=((x0 + x1) / 2.0, y - 0.7), text=text, height_mm=LETTER_MM, align="center")]


def _up(y0: float, y1: float, x: float, *, from_x: tuple[float, float], value: float, name: str = "") -> list[Ink]:
    """Draw a vertical dimension line with extension lines, arrows and value."""
    parts: list[Ink] = [_line((start, y), (x + np.sign(x - start) * 1.0, y)) for y, start in zip((y0, y1), from_x, strict=True)]
    parts += [_line((x, y0), (x, y1)), *_arrows((x, y0), (x, y1))]
    text = f"{name} {value:.2f}".strip()
    return [*parts, Text(at_mm=(x - 0.7, (y0 + y1) / 2.0), text=text, height_mm=LETTER_MM, align="center", turned=True)]


def _line(a: tuple[float, float], b: tuple[float, float]) -> Line:
    return Line(from_mm=(float(a[0]), float(a[1])), to_mm=(float(b[0]), float(b[1])), width_mm=LIGHT_MM)


def _arrows(a: tuple[float, float], b: tuple[float, float]) -> list[Ink]:
    """Draw open arrow heads at both ends of a line."""
    along = np.subtract(b, a)
    length = float(np.linalg.norm(along))
    if length < 2.0 * ARROW_MM:
        return []
    along, aside = along / length, np.array([-along[1], along[0]]) / length
    heads = [(np.array(a), along), (np.array(b), -along)]
    lines = [
        np.array([end + ARROW_MM * (way + 0.2 * s * aside) for s in (-1,)] + [end, end + ARROW_MM * (way + 0.2 * aside)])
        for end, way in heads
    ]
    return [Strokes(lines_mm=tuple(lines), width_mm=LIGHT_MM)]


def _table(part: Part, *, title: str, scale: float) -> list[Ink]:
    """Draw the title and the purpose of a part, and a table with the values and sources of its parameters."""
    left = PAGE_MM[0] - TABLE_WIDE_MM
    wide, deep, high = part.size_mm
    lines = [
        f"{part.name}    x{part.pieces}    scale {_scale_text(scale)}    mm",
        title,
        "",
        *_wrapped(part.about, 62),
        f"print size: {wide:.1f} x {deep:.1f} x {high:.1f}, {part.solid.volume() / 1000.0:.1f} ml of plastic",
        *_wrapped(f"support: {part.support or 'none'}", 62),
        "",
    ]
    for name, value, source in part.numbers:
        lines += [f"{name} = {value:.10g}" if abs(value - round(value, 4)) < 1e-12 else f"{name} = {value:.4f}"]
        lines += [f"    {line}" for line in _wrapped(source, 58)]
    return [
        Text(at_mm=(left, MARGIN_MM + 4.0 + 0.85 * ROW_MM * row), text=text, height_mm=2.6 if row == 0 else LETTER_MM)
        for row, text in enumerate(lines)
    ]


def _wrapped(text: str, most: int) -> list[str]:
    lines: list[str] = []
    for word in text.split():
        if lines and len(lines[-1]) + len(word) < most:
            lines[-1] += f" {word}"
        else:
            lines.append(word)
    return lines


def _scale_text(scale: float) -> str:
    return f"{scale:g}:1" if scale >= 1.0 else f"1:{1.0 / scale:g}"


def rig_page(parts: Sequence[Part], bought: Sequence[Bought], *, title: str) -> Page:
    """Draw the assembled rig on a page, with views from three sides and overall dimensions."""
    whole = Manifold.compose([solid for part in parts for solid in part.placed()] + [one.solid for one in bought])
    drawn = {side.name: draw(whole, side) for side in (FRONT, RIGHT, TOP)}
    cell = (np.array(PAGE_MM) - 2.0 * MARGIN_MM) / 2.0
    largest = np.max([one.size_mm for one in drawn.values()], axis=0)
    scale = max((s for s in SCALES if (s * largest <= cell - 2.0 * ROOM_MM).all()), default=SCALES[-1])
    axis = (Dimension(name="rim to arm axis", from_mm=(0.0, 0.0, 0.0), to_mm=(0.0, 0.0, 0.0)),)
    ink: list[Ink] = []
    for side, place in ((FRONT, (0.5, 0.5)), (RIGHT, (1.5, 0.5)), (TOP, (0.5, 1.5))):
        size = scale * drawn[side.name].size_mm
        corner = np.array([MARGIN_MM, MARGIN_MM]) + cell * np.array(place) + size * np.array([-0.5, 0.5])
        view = _View(side=side, drawn=drawn[side.name], scale=scale, corner_mm=corner)
        ink += _view(view, (), overall=True, stroke_mm=LIGHT_MM)
        x, y = view.at(np.array(axis[0].from_mm))
        ink += [_line((x - 3.0, y), (x + 3.0, y)), _line((x, y - 3.0), (x, y + 3.0))]
    notes = [
        f"{title}: assembled rig, scale {_scale_text(scale)}, mm",
        "The cross marks the origin of the rig frame: the turntable axis in the plane of the canister's rim.",
        "Shown: printed parts, canister, motor, panel, front lamp, and the profiles below the turntable and beside the lamp.",
        "Not shown: the arm and the other profiles.",
    ]
    left = MARGIN_MM + cell[0] + 6.0
    ink += [
        Text(at_mm=(left, MARGIN_MM + cell[1] + 12.0 + ROW_MM * k), text=text, height_mm=2.4 if k == 0 else 1.9)
        for k, text in enumerate(notes)
    ]
    return Page(size_mm=PAGE_MM, parts=tuple(ink))


def exploded(parts: Sequence[Part], bought: Sequence[Bought]) -> list[tuple[str, list[Manifold]]]:
    """Return the name of each object on the rig, and its solids in the exploded view.

    In this view, each solid is displaced by ``apart_mm``.
    """
    things = [(part.name, [solid.translate(part.apart_mm) for solid in part.placed()]) for part in parts if part.rig_from_part]
    for one in bought:
        things.append((one.name, [one.solid.translate(one.apart_mm)]))
    return things


def exploded_page(parts: Sequence[Part], bought: Sequence[Bought], *, title: str) -> Page:
    """Draw the axonometric exploded view of the rig, with the name of each part."""
    things = exploded(parts, bought)
    drawn = draw(Manifold.compose([solid for _, solids in things for solid in solids]), CORNER)
    room = np.array(PAGE_MM) - 2.0 * MARGIN_MM - [70.0, 8.0]
    scale = float((room / drawn.size_mm).min())
    size = scale * drawn.size_mm
    middle = np.array([PAGE_MM[0] / 2.0, PAGE_MM[1] / 2.0 + 3.0])
    view = _View(side=CORNER, drawn=drawn, scale=scale, corner_mm=middle + size * np.array([-0.5, 0.5]))
    ink: list[Ink] = [Strokes(lines_mm=tuple(view.on_page(line) for line in drawn.strokes_mm), width_mm=LIGHT_MM)]
    ink.append(Text(at_mm=(MARGIN_MM, MARGIN_MM + 3.0), text=f"{title}: exploded view, not to scale", height_mm=2.4))
    counts = {name: sum(len(solids) for other, solids in things if other == name) for name, _ in things}
    spots = {name: view.at(_middle(solids[0])) for name, solids in reversed(things)}
    for left in (True, False):
        column = sorted((n for n in spots if bool(spots[n][0] < middle[0]) is left), key=lambda n: float(spots[n][1]))
        x = MARGIN_MM if left else PAGE_MM[0] - MARGIN_MM
        for row, name in enumerate(column):
            y = MARGIN_MM + 16.0 + (PAGE_MM[1] - 2.0 * MARGIN_MM - 24.0) * (row + 0.5) / len(column)
            text = name if counts[name] == 1 else f"{name} x{counts[name]}"
            ink.append(Text(at_mm=(x, y), text=text, height_mm=2.0, align="left" if left else "right"))
            elbow = x + (24.0 if left else -24.0)
            ink.append(Strokes(lines_mm=(np.array([[elbow, y - 0.8], spots[name]]),), width_mm=LIGHT_MM, grey=0.4))
    return Page(size_mm=PAGE_MM, parts=tuple(ink))


def _middle(solid: Manifold) -> Array:
    """Return a vertex (3,) near the centre of the side that faces the viewer.

    The leader line of the part's name ends at this vertex.
    """
    vertices, _ = surface(solid)
    view = vertices @ CORNER.axes.T
    front = view[:, 2] > np.median(view[:, 2])
    middle = np.median(view[front, :2], axis=0)
    nearest = np.argmin(np.hypot(*(view[:, :2] - middle).T) - 0.3 * (view[:, 2] - view[:, 2].max()))
    return np.asarray(vertices[nearest])

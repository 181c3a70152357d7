"""Drawings of a report as SVG: bars, and axes in mm around renderings of the shape. The style sheet has the colours."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes.html_page import Markup, data_uri, escape

if TYPE_CHECKING:
    from rhizotwin.report.sides import Rendering

_BARS_WH = 320.0, 190.0
"""Size of a bar chart, in the unit of its coordinates."""
_LEFT, _RIGHT, _TOP, _BOTTOM = 40.0, 14.0, 10.0, 32.0
"""Margins of the axes, which contain the numbers and the name of an axis."""
_PANEL = 420.0
"""Height of a rendering, in the unit of the coordinates."""
_GAP = 16.0
"""Distance of two renderings."""


def ticks(low: float, high: float, *, most: int) -> NDArray[np.float64]:
    """Return round numbers (N,) from ``low`` to ``high``, at most ``most`` steps of 1, 2 or 5 times a power of ten."""
    least = max(high - low, 1e-9) / most
    power = 10.0 ** np.floor(np.log10(least))
    step = next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= least * (1.0 - 1e-9))
    return np.arange(np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9) + 1.0) * step + 0.0  # without a negative zero


def bars(heights: Sequence[float], width: float, *, name: str, across: str, up: str, colours: Sequence[str] = ()) -> str:
    """Draw a bar chart.

    Parameters
    ----------
    heights : sequence of float
        Heights of the bars.
    width : float
        Width of a bar in the unit of the horizontal axis, which begins at 0. If it is 0, the bars are numbered.
    name, across, up : str
        Names of the chart and of both axes.
    colours : sequence of str
        Colour of each bar. Empty: that of the style sheet.
    """
    total_wide, total_high = _BARS_WH
    wide, high, base = total_wide - _LEFT - _RIGHT, total_high - _TOP - _BOTTOM, total_high - _BOTTOM
    scale, step = high / max(*heights, 1e-9), wide / max(len(heights), 1)
    parts = [_level(_LEFT, _LEFT + wide, base - scale * value, value) for value in ticks(0.0, max(*heights, 1e-9), most=4)]
    for k, value in enumerate(heights):
        fill = f' style="fill:{colours[k]}"' if colours else ""
        x, tall = _LEFT + (k + 0.05) * step, scale * value
        parts.append(f'<rect x="{x:.1f}" y="{base - tall:.1f}" width="{0.9 * step:.1f}" height="{tall:.1f}"{fill}/>')
    if width:
        marks = [(_LEFT + value / width * step, value) for value in ticks(0.0, len(heights) * width, most=7)]
    else:
        marks = [(_LEFT + (k + 0.5) * step, float(k)) for k in range(len(heights))]
    parts += [_text(x, base + 13.0, f"{value:g}") for x, value in marks]
    parts.append(_text(_LEFT + wide / 2.0, total_high - 3.0, across))
    parts.append(f'<text transform="translate(9 {_TOP + high / 2.0:g}) rotate(-90)">{escape(up)}</text>')
    return _svg(total_wide, total_high, parts, name)


def intervals(ends: Sequence[tuple[float, float]]) -> tuple[list[Markup], Markup]:
    """Draw a bar for each interval that contains 0, on a common scale, and the numbers of the scale."""
    low, high = min(end[0] for end in ends), max(end[1] for end in ends)
    marks = ticks(low, high, most=6)
    low, high = min(low, marks[0]), max(high, marks[-1])

    def at(value: float) -> float:
        return 100.0 * (value - low) / (high - low)

    grid = "".join(f'<path class="{"" if value else "zero"}" d="M{at(value):.1f} 0V10"/>' for value in marks)
    drawn = [
        Markup(
            f'<svg class="chart interval" viewBox="0 0 100 10" preserveAspectRatio="none" aria-hidden="true">'
            f'<rect x="{at(start):.1f}" y="1.5" width="{at(stop) - at(start):.1f}" height="7"/>{grid}</svg>'
        )
        for start, stop in ends
    ]
    return drawn, Markup("".join(f'<span style="left:{at(value):.1f}%">{value:.3g}</span>' for value in marks))


def sides(renderings: Sequence[Rendering]) -> str:
    """Draw renderings beside each other at the same scale, with axes in mm."""
    low, high = renderings[0].box[2:]
    scale = _PANEL / (high - low)
    left, base = _LEFT, _TOP + 10.0 + _PANEL
    parts = []
    for one in renderings:
        wide = scale * (one.box[1] - one.box[0])
        at = _scale(left, scale, one.box[0])
        place = f'x="{left:g}" y="{base - _PANEL:g}" width="{wide:.1f}" height="{_PANEL:g}"'
        parts.append(f'<rect class="frame" {place}/>')
        most = max(2, int(wide / 45.0))
        for value in ticks(*one.box[:2], most=most):
            parts.append(f'<path d="M{at(value):.1f} {base:g}v4"/>' + _text(at(value), base + 16.0, f"{value:g}"))
        for value in ticks(low, high, most=8):
            y = base - scale * (value - low)
            parts.append(_level(left, left + wide, y, value) if left == _LEFT else f'<path d="M{left:g} {y:.1f}h{wide:.1f}"/>')
        parts.append(f'<image href="{data_uri("image/webp", one.webp())}" {place}/>')
        parts.append(_text(left + wide / 2.0, base + 30.0, one.side.right_label) + _text(left + wide / 2.0, 13.0, one.side.name))
        left += wide + _GAP
    parts.append(f'<text transform="translate(9 {base - _PANEL / 2.0:g}) rotate(-90)">z (mm)</text>')
    return _svg(left - _GAP + _RIGHT, base + 34.0, parts, "surface from the front and from the side")


def _scale(start: float, scale: float, low: float) -> Callable[[float], float]:
    return lambda value: start + scale * (value - low)


def _level(left: float, right: float, y: float, value: float) -> str:
    """Return a horizontal line with its number on the left."""
    return f'<path d="M{left:g} {y:.1f}H{right:.1f}"/>' + _text(left - 5.0, y + 4.0, f"{value:g}", "end")


def _text(x: float, y: float, text: str, anchor: str = "middle") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(text)}</text>'


def _svg(wide: float, high: float, parts: Sequence[str], name: str) -> str:
    return f'<svg class="chart" viewBox="0 0 {wide:g} {high:g}" role="img" aria-label="{escape(name)}">{"".join(parts)}</svg>'

"""A result as a notebook shows it: a picture of the shape and the numbers, in one piece of HTML."""

from __future__ import annotations

import base64
from html import escape

from rhizotwin.recon.results.result import Result

DPI = 90
"""A figure of 10 inches fills a notebook's 900 px."""


def html(result: Result) -> str:
    """Return the HTML."""
    low, high = result.interval_mm3
    used = sum(camera.used for camera in result.cameras)
    trust = "trusted" if result.trusted else "<b>not trusted</b>"
    rows = [
        ("volume", f"<b>{result.volume_mm3:.1f} mm<sup>3</sup></b>, 90 % interval {low:.1f} to {high:.1f}"),
        ("", f"{trust}{': ' if result.verdict else ''}{escape(result.verdict)}"),
        ("roots", f"{len(result.roots)}, {result.solid.length_mm:.0f} mm" if result.roots else "no centre lines"),
        ("views", f"{used} of {len(result.cameras)} used"),
        *(("warning", escape(warning)) for warning in result.warnings),
    ]
    cells = "".join(f'<tr><td style="text-align:left">{name}</td><td style="text-align:left">{text}</td></tr>' for name, text in rows)
    return f"<div><h4>{escape(result.scene)}</h4>{_picture(result)}<table>{cells}</table></div>"


def _picture(result: Result) -> str:
    """Return the shape as a picture inside the text; nothing where there is no shape."""
    surface = result.solid.surface
    if not len(surface.faces):
        return ""
    from rhizotwin.report import figures  # loads matplotlib
    from rhizotwin.scenes.figures import png

    drawn = base64.b64encode(png(figures.shape_close_up(surface), dpi=DPI)).decode()
    return f'<img alt="the shape from two sides" src="data:image/png;base64,{drawn}">'

"""Display of a result in a notebook: HTML with a picture of the shape and a table of values."""

from __future__ import annotations

from rhizotwin.recon.results.result import Result
from rhizotwin.report import words
from rhizotwin.scenes import html_page
from rhizotwin.scenes.html_page import Markup, escape

DPI = 90
"""Resolution of the figure, dots per inch. A figure with a width of 10 inches fills a notebook of 900 pixels."""


def html(result: Result) -> str:
    """Return the HTML code that represents a result in a notebook."""
    summary = result.summary()
    found, interval = words.volume_text(summary)
    used = sum(camera.used for camera in result.cameras)
    rows = [
        ("volume", Markup(f"<b>{found}</b>, 90 % interval {interval}")),
        ("verdict", "reliable" if result.trusted else Markup(f"<b>not reliable</b>: {escape(result.verdict)}")),
        ("roots", "; ".join([f"{len(result.roots)}", *words.root_summary(summary)[:1]]) if result.roots else "no centre lines"),
        ("views", f"{used} of {len(result.cameras)} used"),
        *(("warning", warning) for warning in result.warnings),
    ]
    return f"<div><h4>{escape(result.scene)}</h4>{_picture(result)}{html_page.table(rows)}</div>"


def _picture(result: Result) -> str:
    """Return the picture of the shape as an HTML element. It is empty if the shape has no surface."""
    surface = result.solid.surface
    if not len(surface.faces):
        return ""
    from rhizotwin.report import figures  # loads matplotlib
    from rhizotwin.scenes.figures import png

    return html_page.image("png", png(figures.shape_close_up(surface, result.roots), dpi=DPI), "shape from two sides")

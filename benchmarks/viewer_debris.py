"""Removal of debris from a scan by clicks in a browser, compared with a scan of the same plant without debris."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from rhizotwin.corrections.session import Session
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.rsml_reader import read_rsml
from rhizotwin.stored import result_files
from rhizotwin.viewer import app
from rhizotwin.viewer.app import Viewer, screen_of

Array = NDArray[np.float64]

_BESIDE_MM = 1.0
"""Maximum distance of a reconstructed root from the true one (a pixel of 400x300 pictures is 0.7 mm)."""
_MOSTLY = 0.5
"""Minimum fraction of a root's points near true debris for it to be debris."""
_PATIENCE_S = 60.0
_CANVAS = """() => [...document.querySelectorAll("canvas")].map(c => c.getBoundingClientRect())
    .map(b => ({x: b.x, y: b.y, width: b.width, height: b.height})).sort((a, b) => b.width * b.height - a.width * a.height)[0]"""
"""The canvas of the scene, which is the largest."""


def measure(browser: Any, result: Path, clean: Path, dataset: Path | None, *, window: dict[str, int]) -> dict[str, tuple[float, str]]:
    """Remove the roots that a scan has in addition to the same scan without debris, and compare the volumes.

    Parameters
    ----------
    browser : Browser
        Playwright browser.
    result, clean : Path
        Results with debris and without.
    dataset : Path or None
        Folder of the pictures with debris.
    window : dict of str to int
        Width and height (px).

    Returns
    -------
    dict of str to tuple of float and str
        Numbers of debris roots and clicks, and relative differences of the volume from that of the clean scan before
        and after.

    Raises
    ------
    UserError
        If a click does not select the intended root.
    """
    wanted = float(result_files.read_summary(clean)["volume_mm3"])
    viewer = app.start([result], dataset)
    try:
        strange = debris(viewer.shown.session, added_mm(_truth(result), _truth(clean)))
        before = viewer.shown.session.measure().volume_mm3
        clicks = _remove_roots(browser, viewer, strange, window) if strange else 0
        after = viewer.shown.session.measure().volume_mm3
    finally:
        viewer.served.stop()
    return {
        "debris_roots": (float(len(strange)), "1"),
        "debris_clicks": (float(clicks), "1"),
        "volume_with_debris": (before / wanted - 1.0, "1"),
        "volume_without_debris": (after / wanted - 1.0, "1"),
    }


def added_mm(roots: Sequence[Root], clean: Sequence[Root]) -> Array:
    """Return the points (N, 3) of true roots that the truth of the clean scan does not contain."""
    known = {root.points_mm.tobytes() for root in clean}
    return np.concatenate([np.zeros((0, 3)), *(root.points_mm for root in roots if root.points_mm.tobytes() not in known)])


def debris(session: Session, added: Array) -> list[int]:
    """Return the roots that are mostly near points (N, 3) of true debris."""
    there = cKDTree(added)
    away = {number: there.query(line.points_mm)[0] for number, line in session.state.lines.items()}
    return [number for number, mm in away.items() if float((mm < _BESIDE_MM).mean()) > _MOSTLY]


def _truth(result: Path) -> tuple[Root, ...]:
    """Return the true roots of a simulated scan."""
    return read_rsml(Path(str(result_files.read_summary(result)["dataset"])) / "truth" / "skeleton.rsml")


def _remove_roots(browser: Any, viewer: Viewer, numbers: list[int], window: dict[str, int]) -> int:
    """Select roots by clicks and delete them; return the number of clicks."""
    page = browser.new_page(viewport=window)
    page.goto(viewer.served.address)
    clients = viewer.served.server.get_clients
    _wait(lambda: bool(clients()), "the page")
    page.get_by_role("tab", name="Edit").click()
    page.get_by_text("Nothing is selected").wait_for()
    for place, number in enumerate(numbers):
        x, y = _where(page, viewer, number)
        page.mouse.move(x, y)
        if place:
            page.keyboard.down("Shift")
        page.mouse.click(x, y)
        page.keyboard.up("Shift")
        _wait(partial(_is_chosen, viewer, number), f"a click on root {number}")
    page.get_by_role("button", name="Delete (Del)", exact=True).click()
    _wait(lambda: not set(numbers) & set(viewer.shown.session.state.lines), "the roots to go")
    page.close()
    return len(numbers) + 1


def _is_chosen(viewer: Viewer, number: int) -> bool:
    return number in viewer.roots


def _where(page: Any, viewer: Viewer, number: int) -> tuple[float, float]:
    """Return the position on the page at which a root can be clicked: its point farthest from all others."""
    screen = screen_of(max(viewer.served.server.get_clients().items())[1])
    lines = viewer.shown.session.state.lines
    seen = {k: line.points_mm @ screen.camera_from_world[:3, :3].T + screen.camera_from_world[:3, 3] for k, line in lines.items()}
    flat = {k: at[:, :2] / at[:, 2:] for k, at in seen.items()}
    others = np.concatenate([at for k, at in flat.items() if k != number])
    u, v = flat[number][int(cKDTree(others).query(flat[number])[0].argmax())] / np.tan(screen.fov / 2.0)
    box = page.evaluate(_CANVAS)
    return box["x"] + box["width"] * (0.5 + 0.5 * u / screen.aspect), box["y"] + box["height"] * (0.5 + 0.5 * v)


def _wait(until: Callable[[], bool], what: str) -> None:
    end = time.monotonic() + _PATIENCE_S
    while not until():
        if time.monotonic() > end:
            raise UserError(f"waited in vain for {what}")
        time.sleep(0.02)

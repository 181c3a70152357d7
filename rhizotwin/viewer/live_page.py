"""The live page of a scan: last picture with markers, measurements with limits, sketch of the roots, pause and stop."""

from __future__ import annotations

import html
import threading

import cv2
import numpy as np
from numpy.typing import NDArray

from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.settings import TrustSettings
from rhizotwin.rig.scanning import picture_change, preflight
from rhizotwin.rig.scanning.observer import Look
from rhizotwin.scenes.picture_codec import Grey
from rhizotwin.viewer import guard
from rhizotwin.viewer.guard import Served
from rhizotwin.viewer.live import FRUSTUM_PX, Live, shrink
from rhizotwin.viewer.scene3d import Scene3d

TRUST = TrustSettings()
"""Limits of the checks of the reconstruction."""
PICTURE_PX = 640
"""Largest width of a picture on the page."""
_MARKER_RGB = (0, 210, 90)
_GOOD, _FAIR, _BAD = "#2e8b57", "#d98e04", "#c0392b"
_STATES = {"good": _GOOD, "fair": _FAIR, "bad": _BAD}


def serve(live: Live, *, host: str = guard.LOCAL, port: int = 8080) -> Served:
    """Serve the live page of a scan.

    Raises
    ------
    UserError
        If the port cannot be used.
    """
    served = guard.serve(host=host, port=port, title="rhizotwin scan")
    _Page(served, live)
    served.open.set()
    return served


class _Page:
    """The live page."""

    def __init__(self, served: Served, live: Live) -> None:
        self._live, self._server = live, served.server
        self._scene = Scene3d(served.server)
        self._lock = threading.Lock()
        self._shown: list[str] = []
        self._file = ""
        self._cells: NDArray[np.float64] | None = None
        gui = served.server.gui
        gui.configure_theme(dark_mode=False, show_logo=False, show_share_button=False, control_width="large")
        gui.main_panel.dock_right()
        self._head = gui.add_html("")
        self._bar = gui.add_progress_bar(0.0)
        buttons = gui.add_button_group("Scan", ("Pause", "Continue", "Stop"))
        empty = np.full((PICTURE_PX * 3 // 4, PICTURE_PX, 3), 235, np.uint8)
        self._picture = gui.add_image(empty, label="Last picture", format="jpeg", jpeg_quality=85)
        self._meters = gui.add_html("")
        self._lines = gui.add_html("")

        @buttons.on_click
        def _(_: object) -> None:
            {"Pause": lambda: live.pause(paused=True), "Continue": lambda: live.pause(paused=False), "Stop": live.stop}[
                str(buttons.value)
            ]()

        self._scene.show_canister(live.scene)
        can = live.scene.canister
        reach = can.outer_radius_mm + max(ring.distance_mm for ring in live.scene.plan.rings)
        corners = np.array([[-reach, -reach, -can.height_mm], [reach, reach, 0.0]])
        self._scene.set_home(0.5 * corners)
        live.on_change.append(self.follow)
        self.follow()

    def follow(self) -> None:
        """Update the page."""
        live = self._live
        with self._lock:
            self._head.content = head(live)
            self._bar.value = 100.0 * live.done / max(live.total, 1)  # type: ignore[misc]  # viser declares it read-only
            self._lines.content = "<div style='padding:0.3em 0.8em'>" + "<br>".join(map(html.escape, live.lines)) + "</div>"
            self._meters.content = meters(live.looks[-1] if live.looks else None, live.panel)
            if live.looks and live.looks[-1].frame.file != self._file:
                self._file = live.looks[-1].frame.file
                self._picture.image = draw_markers(live.looks[-1])
            self._draw_ring()
            if live.cells_mm is not self._cells:
                self._cells = live.cells_mm
                self._scene.show_voxels(live.cells_mm, np.full(len(live.cells_mm), 0.6), live.cell_mm)

    def _draw_ring(self) -> None:
        """Draw the cameras found from markers, with their pictures."""
        looks = {look.frame.file: look for look in self._live.looks if look.sighting is not None}
        for file in [file for file in self._shown if file not in looks]:
            self._shown.remove(file)
            self._scene.drop(f"/cameras/{file}")
        for file, look in looks.items():
            if file not in self._shown and look.sighting is not None:
                self._shown.append(file)
                view = View(camera=self._live.scene.camera, cam_from_canister=look.sighting.cam_from_canister)
                self._scene.show_camera(file, view, bright(shrink(look.image, FRUSTUM_PX)))


def head(live: Live) -> str:
    """Return the state of the scan as HTML."""
    if live.ended:
        state = "<b>Scan finished.</b>"
    elif live.stopping:
        state = "<b>Stopping:</b> lights off, arm parked; pictures are kept."
    elif live.paused:
        state = "<b>Paused:</b> lights on, motor and arm hold. <i>Continue</i> takes the next picture."
    else:
        left_s = live.left_s()
        state = "scanning" + ("" if left_s is None else f", about {duration(left_s)} left")
    return f"<div style='padding:0.3em 0.8em'><b>{live.done} of {live.total} pictures</b><br>{state}</div>"


def duration(seconds: float) -> str:
    """Format a duration."""
    return f"{seconds:.0f} s" if seconds < 90.0 else f"{seconds / 60.0:.0f} min"


def meters(look: Look | None, panel: tuple[float, float] | None) -> str:
    """Return the measurements of the last picture with their limits as HTML."""
    rows = []
    if look is not None:
        seen, light = look.sighting, look.exposure
        good, bad = TRUST.blur_px
        if seen is None:
            rows.append(("Markers", "not detected", "the angle is that of the turntable", "fair"))
        else:
            rows.append(("Markers", f"{seen.markers} detected", f"reprojection error {seen.reprojection_px:.2f} px", "good"))
        if seen is not None and seen.blur_px is not None:
            state = "good" if seen.blur_px <= good else "fair" if seen.blur_px <= bad else "bad"
            rows.append(("Focus", f"edge width {seen.blur_px:.2f} px", f"good up to {good:g} px, bad above {bad:g} px", state))
        least, most = 100.0 * preflight.DIMMEST, 100.0 * preflight.MOST_SATURATED
        state = "good" if light.bright >= preflight.DIMMEST and light.saturated <= preflight.MOST_SATURATED else "bad"
        text = f"{100.0 * light.bright:.0f} % of full scale, {100.0 * light.saturated:.1f} % saturated"
        rows.append(("Exposure", text, f"at least {least:.0f} %; at most {most:.0f} % saturated", state))
    if panel is not None and panel[1] > 0.0:
        good, bad = TRUST.dim
        state = "good" if panel[0] >= good else "fair" if panel[0] >= bad else "bad"
        text = f"darkest part {100.0 * panel[0] / panel[1]:.0f} % of the brightest"
        rows.append(
            ("Panel uniformity", text, f"darkest part {100.0 * panel[0]:.0f} % of full scale; good from {100.0 * good:.0f} %", state)
        )
    if look is not None and look.motion is not None:
        state = "good" if look.motion < picture_change.LEAST_SHARE else "fair"
        text = "at rest" if state == "good" else f"{100.0 * look.motion:.1f} % of the picture moving"
        rows.append(("Motion after stop", text, f"limit {100.0 * picture_change.LEAST_SHARE:g} %; raise settle_s in the rig file", state))
    cells = "".join(
        f"<tr><td style='vertical-align:top;padding-right:0.6em'><span style='color:{_STATES[state]}' title='{state}'>&#9679;</span> "
        f"<b>{name}</b></td><td>{html.escape(text)}<br><small>{state}; {html.escape(limit)}</small></td></tr>"
        for name, text, limit, state in rows
    )
    return f"<div style='padding:0.3em 0.8em'><table>{cells}</table></div>"


def bright(image: Grey) -> NDArray[np.uint8]:
    """Convert a picture to sRGB (H, W, 3)."""
    light = image.astype(np.float32) / np.iinfo(image.dtype).max
    shown = np.round(255.0 * light ** (1.0 / 2.2)).astype(np.uint8)  # from linear intensities to a screen's gamma
    return np.repeat(shown[..., None], 3, axis=2)


def draw_markers(look: Look) -> NDArray[np.uint8]:
    """Draw the detected markers into a picture."""
    image = bright(shrink(look.image, PICTURE_PX))
    if look.sighting is not None:
        scale = image.shape[1] / look.image.shape[1]
        corners = (look.sighting.corners_px + 0.5) * scale - 0.5
        cv2.polylines(image, list(np.round(corners * 16).astype(np.int32)), True, _MARKER_RGB, 1, cv2.LINE_AA, 4)
    return image

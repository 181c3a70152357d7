"""Interactive viewer: results in 3D, pictures with the outline of the reconstruction, and corrections.

All connected browsers show the same state.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from rhizotwin.corrections import log as logs
from rhizotwin.corrections.deletions import find_edited
from rhizotwin.corrections.lines import descendants
from rhizotwin.scenes import frames
from rhizotwin.scenes.errors import UserError
from rhizotwin.viewer import guard, picking
from rhizotwin.viewer.drawing import Drawing
from rhizotwin.viewer.look import CLICKS
from rhizotwin.viewer.picking import Ray, Screen

Array = NDArray[np.float64]

CLICK_SHARE = 0.01
"""Maximum distance between a click into a picture and the root that it selects, as a fraction of the picture's height.
It is nine pixels of a screen of 900 pixels."""
_PREPARE_AFTER_S = 3.0
"""Time between the connection of the first browser and the preparation of corrections, s. The browser needs this time
to draw a plant of day 30, and the preparation must not delay it."""


class Viewer(Drawing):
    """Results displayed in browsers, with selection and corrections."""

    # selection

    def clicked(self, ray: Ray, *, more: bool = False) -> None:
        """Handle a click into the 3D scene according to the selected click mode.

        Parameters
        ----------
        ray : Ray
            Ray from the eye through the clicked point.
        more : bool
            Whether the clicked object is added to the selection.
        """
        with self.lock:
            if self.picture is not None:
                self._click_picture(ray, more=more)
                return
            if self.look.click == CLICKS[1]:
                self._click_voxel(ray, more=more)
                return
            hit = picking.root_at(self.nodes(), ray)
            if hit is None:
                self._click_background(ray, more=more)
                return
            number, point = hit
            if self.look.click == CLICKS[0]:
                self._select(number, more=more)
            elif self.look.click == CLICKS[2]:
                self._measure_at(point)
            else:
                kind = {CLICKS[3]: "cut", CLICKS[4]: "tip", CLICKS[5]: "base"}[self.look.click]
                self.correct(kind, roots=[number], point_mm=tuple(float(x) for x in point))
                return
            self.show_selection()

    def _select(self, number: int, *, more: bool) -> None:
        """Select a root. If ``more``, it is added to the selection, or removed if it is selected."""
        if more and number in self.roots:
            self.roots.remove(number)
        else:
            self.roots = [*self.roots, number] if more else [number]
            if not more:
                self.voxels.clear()

    def _click_picture(self, ray: Ray, *, more: bool) -> None:
        """Select the root that is projected through the water to the clicked point of the displayed picture."""
        pictures, place, parts = self.shown.pictures, self.picture, self.visible()
        if pictures is None or place is None or not parts:
            return
        view = pictures.views[place]
        toward = view.cam_from_canister[:3, :3] @ ray.direction
        clicked_px = toward[:2] / toward[2] * view.camera.focal_px + view.camera.principal_px
        numbers = np.concatenate([np.full(sum(len(one.points_mm) for one in lines), number) for number, lines in parts.items()])
        px = pictures.pixels(place, np.concatenate([one.points_mm for lines in parts.values() for one in lines]))
        away_px = np.nan_to_num(np.linalg.norm(px - clicked_px, axis=1), nan=np.inf)
        nearest = int(away_px.argmin())
        if away_px[nearest] <= CLICK_SHARE * view.camera.image_wh[1]:
            self._select(int(numbers[nearest]), more=more)
        elif not more:
            self.roots = []
        self.show_selection()
        self._draw_picture()

    def _click_background(self, ray: Ray, *, more: bool) -> None:
        """Handle a click that hits no root.

        In the click mode for distances, a voxel that is hit is used as a point of the measurement. Otherwise the
        selection is cleared.
        """
        hit = self._voxel_at(ray) if self.look.click == CLICKS[2] else None
        if hit is not None:
            self._measure_at(hit[1])
            self.show_selection()
        elif not more:
            self.deselect()

    def _measure_at(self, point_mm: Array) -> None:
        self.measured = [*self.measured, point_mm] if len(self.measured) < 2 else [point_mm]

    def _voxel_at(self, ray: Ray) -> tuple[int, Array] | None:
        """Return the index of the first voxel on a ray, and the point (3,), mm, at which the ray enters it.

        Return None if the ray hits no voxel.
        """
        solid, rows = self.shown.session.measure().solid, self.voxel_rows()
        hit = picking.voxel_at(solid.centre_mm[rows], np.asarray(0.5 * solid.size[rows] * solid.voxel_mm), ray)
        return None if hit is None else (int(rows[hit[0]]), hit[1])

    def _click_voxel(self, ray: Ray, *, more: bool) -> None:
        hit = self._voxel_at(ray)
        if not more:
            self.voxels.clear()
            self.roots.clear()
        if hit is not None:
            self.voxels ^= {hit[0]}
        self.show_selection()

    def select_rectangle(self, screen: Screen, low: tuple[float, float], high: tuple[float, float]) -> None:
        """Select the objects in a screen rectangle.

        These are voxels if voxels are displayed, otherwise roots that lie completely inside the rectangle.
        """
        with self.lock:
            if self.look.click == CLICKS[1] or "voxels" in self.look.layers:
                rows = self.voxel_rows()
                inside = screen.inside(self.shown.session.measure().solid.centre_mm[rows], low, high)
                self.voxels |= {int(row) for row in rows[inside]}
            else:
                points = {k: np.concatenate([part.points_mm for part in parts]) for k, parts in self.visible().items()}
                self.roots += [k for k, at in points.items() if k not in self.roots and screen.inside(at, low, high).all()]
            self.show_selection()

    def select_box(self, low_mm: Sequence[float], high_mm: Sequence[float]) -> None:
        """Select the voxels whose centres lie in a box. The corners of the box are in the canister frame, mm."""
        with self.lock:
            measured = self.shown.session.measure()
            rows = measured.solid.leaves_in(low_mm, high_mm)
            self.voxels = {int(row) for row in rows[rows < len(measured.volumes_mm3)] if measured.volumes_mm3[row] > 1e-9}
            self.show_selection()

    def select_root(self, number: int) -> None:
        """Select a single root."""
        with self.lock:
            self.roots, self.voxels = [number], set()
            self.show_selection()

    def deselect(self) -> None:
        """Clear the selection."""
        with self.lock:
            self.roots, self.voxels, self.measured = [], set(), []
            self.show_selection()

    # corrections

    def prepare(self) -> None:
        """Load the data that the first click and the first correction need."""
        self.nodes()
        _ = self.shown.session.solid

    def correct(self, kind: str, **fields: Any) -> None:
        """Apply a correction (see `corrections.log.Edit`) and display the result."""
        with self.lock:
            try:
                self.shown.session.do(logs.edit(kind, **fields))
                self.message = ""
            except UserError as error:
                self.notify(str(error))
                return
            self.voxels.clear()
            self.refresh()

    def delete(self, *, laterals: bool = False) -> None:
        """Delete the selected roots and voxels."""
        with self.lock:
            rows, roots = sorted(self.voxels), list(self.roots)
            if not rows and not roots:
                self.notify("nothing was deleted, because nothing is selected")
                return
            if roots:
                if laterals:  # selected laterals of selected roots are deleted with these roots
                    lines = self.shown.session.state.lines
                    under = {one for k in roots for one in descendants(lines, k)[1:]}
                    roots = [k for k in roots if k not in under]
                self.correct("delete roots", roots=roots, laterals=laterals)
            if rows:
                self.correct("delete voxels", runs=logs.runs(rows))

    def pair(self, kind: str) -> None:
        """Apply a correction to exactly two selected roots, in the order in which they were selected."""
        if len(self.roots) != 2:
            self.notify("two roots must be selected; click the first root, then hold Shift and click the second root")
            return
        self.correct(kind, roots=self.roots)

    def restore(self) -> None:
        """Restore the last deletion that was not restored, and name the roots that were edited since and remain cut."""
        with self.lock:
            state = self.shown.session.state
            edited = find_edited(state.lines, state.deletions[-1]) if state.deletions else []
            self.correct("restore deletion")
            if edited:
                names = ", ".join(map(str, edited))
                self.notify(f"root {names} was edited after the deletion and keeps its present shape; undo later corrections to restore it")

    def refit(self) -> None:
        """Refit the roots to the pictures."""
        self.notify("the roots are being refitted to the pictures ...")
        self.correct("fit")

    def undo(self) -> None:
        """Undo the last correction."""
        with self.lock:
            self.shown.session.undo()
            self.refresh()

    def undo_to(self, count: int) -> None:
        """Undo corrections until ``count`` corrections remain."""
        with self.lock:
            while len(self.shown.session.log.edits) > count:
                self.shown.session.undo()
            self.refresh()

    def look_from(self, client: viser.ClientHandle, view: str) -> None:
        """Set the camera of a browser to a preset view (see `scene3d.VIEWS`)."""
        if self.picture is not None:
            self.enter_picture(None, client)
        with client.atomic():
            client.camera.up_direction = (0.0, 0.0, 1.0)
            client.camera.position = self.scene.camera_position(view, aspect=client.camera.aspect)
            client.camera.look_at, client.camera.fov = self.scene.home[0], np.deg2rad(40.0)

    def redo(self) -> None:
        """Redo the correction that was undone last."""
        with self.lock:
            self.shown.session.redo()
            self.refresh()

    def save(self) -> None:
        """Save the corrections as ``edits.json`` in the result's folder."""
        try:
            path = self.shown.session.save()
        except UserError as error:
            self.notify(f"the corrections could not be saved: {error}")
            return
        self.notify(f"the corrections were saved to {path}; apply them with: rhizotwin edit {path.parent} --apply {path} -o NEW_RESULT")


def _report_errors(viewer: Viewer) -> None:
    """Show the exceptions of all handlers of clicks and controls in the browsers.

    Viser only prints them with a traceback (version 1.1.1).
    """
    handlers = viewer.served.server._thread_executor  # all handlers run in it, and viser has no hook for their exceptions
    submit = handlers.submit

    def submit_reporting(handler: Callable[..., Any], /, *arguments: Any, **options: Any) -> Future[Any]:
        return submit(_reporting(viewer, handler), *arguments, **options)

    handlers.submit = submit_reporting  # type: ignore[method-assign]


def _reporting(viewer: Viewer, action: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that calls another one, and shows its exceptions in the browsers."""

    def reporting(*arguments: Any, **options: Any) -> Any:
        try:
            return action(*arguments, **options)
        except BaseException as error:  # noqa: BLE001 - shown, while the viewer goes on
            viewer.report(error)

    return reporting


def ray_of(origin: Sequence[float], direction: Sequence[float]) -> Ray:
    """Return a ray from an origin along a direction, which is normalized."""
    way = np.asarray(direction, np.float64)
    return Ray(np.asarray(origin, np.float64), way / np.linalg.norm(way))


def screen_of(client: viser.ClientHandle) -> Screen:
    """Return the camera of a browser."""
    camera = client.camera
    world_from_camera = np.eye(4)
    world_from_camera[:3, :3] = viser.transforms.SO3(np.asarray(camera.wxyz)).as_matrix()
    world_from_camera[:3, 3] = camera.position
    return Screen(frames.invert(world_from_camera), float(camera.fov), float(camera.aspect))


def start(
    folders: Sequence[Path], dataset: Path | None, *, temporary: Collection[Path] = (), host: str = guard.LOCAL, port: int = 8080
) -> Viewer:
    """Start a server that displays results in browsers. Corrections cannot be saved in temporary folders.

    Raises
    ------
    UserError
        If a result cannot be read, or the address cannot be used.
    """
    return show(guard.serve(host=host, port=port), folders, dataset, temporary=temporary)


def show(served: guard.Served, folders: Sequence[Path], dataset: Path | None, *, temporary: Collection[Path] = ()) -> Viewer:
    """Display results on a running server. Browsers may already be connected.

    Raises
    ------
    UserError
        If a result cannot be read.
    """
    from rhizotwin.viewer import panels

    try:
        viewer = Viewer(served, folders, dataset, temporary=temporary)
    except UserError:
        served.stop()
        raise
    panels.build(viewer)
    served.open.set()
    _report_errors(viewer)
    prepare = threading.Timer(_PREPARE_AFTER_S, _reporting(viewer, viewer.prepare))
    prepare.daemon = True
    begin = threading.Lock()

    @served.server.on_client_connect
    def _(_: viser.ClientHandle) -> None:
        if begin.acquire(blocking=False):  # only for the first browser
            prepare.start()

    return viewer

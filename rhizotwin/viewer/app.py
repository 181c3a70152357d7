"""The viewer: results in 3D, their pictures through the water, and corrections. All browsers see one state."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from rhizotwin.corrections import log as logs
from rhizotwin.corrections.lines import below
from rhizotwin.scenes import frames
from rhizotwin.scenes.errors import UserError
from rhizotwin.viewer import guard, picking
from rhizotwin.viewer.drawing import CLICKS, Drawing
from rhizotwin.viewer.picking import Ray, Screen

Array = NDArray[np.float64]

_PREPARE_AFTER_S = 3.0
"""Between the first browser and the work that only corrections need: by then a day-30 plant is drawn."""


class Viewer(Drawing):
    """Results served to browsers, to be chosen from and corrected."""

    # choosing

    def clicked(self, ray: Ray, *, more: bool = False) -> None:
        """Answer a click into the scene.

        Parameters
        ----------
        more : bool
            Add to what is chosen.
        """
        with self.lock:
            if self.standing is not None:
                return
            if self.look.click == CLICKS[1]:
                self._click_voxel(ray, more=more)
                return
            hit = picking.root_at(self.strung(), ray)
            if hit is None and not self._click_beside(ray):
                if not more:
                    self.choose_nothing()
                return
            if hit is None:
                self.answer()
                return
            number, point = hit
            if self.look.click == CLICKS[0]:
                if more and number in self.roots:
                    self.roots.remove(number)
                else:
                    self.roots = [*self.roots, number] if more else [number]
                    if not more:
                        self.voxels.clear()
            elif self.look.click == CLICKS[2]:
                self._measure_at(point)
            else:
                kind = {CLICKS[3]: "cut", CLICKS[4]: "tip", CLICKS[5]: "base"}[self.look.click]
                self.do(kind, roots=[number], point_mm=tuple(float(x) for x in point))
                return
            self.answer()

    def _click_beside(self, ray: Ray) -> bool:
        """Answer a click that meets no root: measure on the shape itself; tell whether that was meant."""
        if self.look.click != CLICKS[2]:
            return False
        hit = self._voxel_at(ray)
        if hit is not None:
            self._measure_at(hit[1])
        return hit is not None

    def _measure_at(self, point_mm: Array) -> None:
        self.measured = [*self.measured, point_mm] if len(self.measured) < 2 else [point_mm]

    def _voxel_at(self, ray: Ray) -> tuple[int, Array] | None:
        """Return the row of the voxel that a ray meets first, and where."""
        solid, rows = self.shown.session.measure().solid, self._voxel_rows()
        hit = picking.voxel_at(solid.centre_mm[rows], np.asarray(0.5 * solid.size[rows] * solid.voxel_mm), ray)
        return None if hit is None else (int(rows[hit[0]]), hit[1])

    def _click_voxel(self, ray: Ray, *, more: bool) -> None:
        hit = self._voxel_at(ray)
        if not more:
            self.voxels.clear()
            self.roots.clear()
        if hit is not None:
            self.voxels ^= {hit[0]}
        self.answer()

    def choose_rectangle(self, screen: Screen, low: tuple[float, float], high: tuple[float, float]) -> None:
        """Choose what shows inside a rectangle.

        Voxels where they are shown or clicked, else the roots that lie wholly inside.
        """
        with self.lock:
            if self.look.click == CLICKS[1] or "voxels" in self.look.layers:
                rows = self._voxel_rows()
                inside = screen.inside(self.shown.session.measure().solid.centre_mm[rows], low, high)
                self.voxels |= {int(row) for row in rows[inside]}
            else:
                points = {k: np.concatenate([part.points_mm for part in parts]) for k, parts in self.visible().items()}
                self.roots += [k for k, at in points.items() if k not in self.roots and screen.inside(at, low, high).all()]
            self.answer()

    def choose_box(self, low_mm: Sequence[float], high_mm: Sequence[float]) -> None:
        """Choose the voxels whose middles lie in a box."""
        with self.lock:
            measured = self.shown.session.measure()
            rows = measured.solid.leaves_in(low_mm, high_mm)
            self.voxels = {int(row) for row in rows[rows < len(measured.volumes_mm3)] if measured.volumes_mm3[row] > 1e-9}
            self.answer()

    def choose_nothing(self) -> None:
        """Choose nothing."""
        with self.lock:
            self.roots, self.voxels, self.measured = [], set(), []
            self.answer()

    # corrections

    def prepare(self) -> None:
        """Do what the first click and the first correction would wait for, and measure what needs no haste."""
        self.strung()
        _ = self.shown.session.solid
        self.drawn()

    def do(self, kind: str, **what: Any) -> None:
        """Make a correction and show what it comes to."""
        with self.lock:
            try:
                self.shown.session.do(logs.edit(kind, **what))
                self.told = ""
            except UserError as error:
                self.say(str(error))
                return
            self.voxels.clear()
            self.refresh()

    def delete(self, *, laterals: bool = False) -> None:
        """Take away what is chosen."""
        with self.lock:
            rows, roots = sorted(self.voxels), list(self.roots)
            if not rows and not roots:
                self.say("nothing is chosen")
                return
            if roots:
                if laterals:  # those that hang on others that are chosen go with them
                    lines = self.shown.session.state.lines
                    under = {below_one for k in roots for below_one in below(lines, k)[1:]}
                    roots = [k for k in roots if k not in under]
                self.do("delete roots", roots=roots, laterals=laterals)
            if rows:
                self.do("delete voxels", runs=logs.runs(rows))

    def pair(self, kind: str) -> None:
        """Join or hang the two chosen roots, in the order of the clicks."""
        if len(self.roots) != 2:
            self.say("choose two roots: click the first, then click the second with Shift held")
            return
        self.do(kind, roots=self.roots)

    def restore(self) -> None:
        """Bring back what was taken away last and is still away; what was cut of other roots stays cut."""
        with self.lock:
            roots, rows = self.shown.session.taken_last()
            if not roots and not len(rows):
                self.say("nothing was taken away")
                return
            if len(rows):
                self.do("restore voxels", runs=logs.runs([int(row) for row in rows]))
            if roots:
                self.do("restore roots", roots=roots)

    def fit_again(self) -> None:
        """Fit the roots to the pictures again."""
        from rhizotwin.corrections import refit  # with what computes

        shown = self.shown
        if shown.dataset is None:
            self.say("fitting again needs the pictures: start `rhizotwin view RESULT DATASET`")
            return
        self.say("fitting the roots to the pictures again ...")
        shown.session.refit = refit.fitter(shown.session.folder, shown.dataset)
        self.do("fit")

    def undo(self) -> None:
        """Take the last correction back."""
        with self.lock:
            self.shown.session.undo()
            self.refresh()

    def redo(self) -> None:
        """Make a correction again that was undone."""
        with self.lock:
            self.shown.session.redo()
            self.refresh()

    def save(self) -> None:
        """Write the log beside the result."""
        path = self.shown.session.save()
        self.say(f"wrote {path}; rhizotwin edit {path.parent} --apply {path} -o NEW makes the corrected result")


def ray_of(origin: Sequence[float], direction: Sequence[float]) -> Ray:
    """Return a browser's ray."""
    way = np.asarray(direction, np.float64)
    return Ray(np.asarray(origin, np.float64), way / np.linalg.norm(way))


def screen_of(client: viser.ClientHandle) -> Screen:
    """Return how a browser looks."""
    camera = client.camera
    world_from_camera = np.eye(4)
    world_from_camera[:3, :3] = viser.transforms.SO3(np.asarray(camera.wxyz)).as_matrix()
    world_from_camera[:3, 3] = camera.position
    return Screen(frames.invert(world_from_camera), float(camera.fov), float(camera.aspect))


def start(folders: Sequence[Path], dataset: Path | None, *, host: str = guard.LOCAL, port: int = 8080) -> Viewer:
    """Serve results.

    Raises
    ------
    UserError
        Where a result cannot be read, or nothing can be served.
    """
    return show(guard.serve(host=host, port=port), folders, dataset)


def show(served: guard.Served, folders: Sequence[Path], dataset: Path | None) -> Viewer:
    """Show results to browsers, which may have come already.

    Raises
    ------
    UserError
        Where a result cannot be read.
    """
    from rhizotwin.viewer import panels

    try:
        viewer = Viewer(served, folders, dataset)
    except UserError:
        served.stop()
        raise
    panels.build(viewer)
    served.open.set()
    prepare = threading.Timer(_PREPARE_AFTER_S, viewer.prepare)
    prepare.daemon = True
    begin = threading.Lock()

    @served.server.on_client_connect
    def _(_: viser.ClientHandle) -> None:
        if begin.acquire(blocking=False):  # once
            prepare.start()

    return viewer

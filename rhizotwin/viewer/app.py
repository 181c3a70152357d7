"""The viewer: results in 3D, their pictures through the water, and corrections. All browsers see one state."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from rhizotwin.corrections import log as logs
from rhizotwin.corrections import refit
from rhizotwin.corrections.lines import Line, below
from rhizotwin.scenes import frames
from rhizotwin.scenes.errors import UserError
from rhizotwin.viewer import colours, guard, picking
from rhizotwin.viewer.guard import Served
from rhizotwin.viewer.picking import Ray, Screen
from rhizotwin.viewer.scene3d import Scene3d, field_of_view, quaternion
from rhizotwin.viewer.shown import Shown

Array = NDArray[np.float64]

LAYERS = ("roots", "surface", "voxels", "canister", "cameras", "truth")
CLICKS = ("choose a root", "choose a voxel", "measure", "cut here", "end it here", "plant begins here")
TRUTH = ("over", "beside", "distance colours")
_ASIDE_MM = 60.0


@dataclass
class Look:
    """How the result is shown."""

    layers: set[str] = field(default_factory=lambda: {"roots", "canister", "cameras"})
    colour: str = "order"
    truth: str = TRUTH[0]
    low_mm: float = -1e9
    high_mm: float = 1e9
    click: str = CLICKS[0]


class Viewer:
    """Results served to browsers."""

    def __init__(self, served: Served, folders: Sequence[Path], dataset: Path | None = None) -> None:
        self.served, self.look = served, Look()
        self.scene = Scene3d(served.server)
        self._folders, self._dataset = list(folders), dataset
        self._loaded: dict[int, Shown] = {}
        self._place = 0
        self.lock = threading.RLock()
        self.roots: list[int] = []
        """Chosen, in the order of the clicks."""
        self.voxels: set[int] = set()
        self.measured: list[Array] = []
        self.standing: int | None = None
        """The picture that browsers stand in."""
        self.on_change: list[Callable[[], None]] = []
        """Called when what the panels say may have changed."""
        self.told = ""
        """The last sentence to the user."""
        self.load(0)

    @property
    def shown(self) -> Shown:
        """Return the result that is shown."""
        return self._loaded[self._place]

    @property
    def names(self) -> list[str]:
        """Return the names of all results."""
        return [folder.name or str(folder) for folder in self._folders]

    def load(self, place: int) -> None:
        """Show another result."""
        with self.lock:
            if place not in self._loaded:
                self._loaded[place] = Shown(self._folders[place], self._dataset)
            self._place = place
            self.roots, self.voxels, self.measured = [], set(), []
            self.scene.clear()
            self.standing = None
            self.served.server.scene.set_background_image(None)
            shown = self.shown
            points = np.concatenate([line.points_mm for line in shown.session.state.lines.values()] or [shown.session.solid.centre_mm])
            self.scene.look_at(points, rim_mm=60.0)
            if not shown.session.state.lines:
                self.look.layers |= {"surface"}
            self.refresh()

    def changed(self) -> None:
        """Let the panels follow."""
        for follow in self.on_change:
            follow()

    def say(self, text: str) -> None:
        """Tell the user something."""
        self.told = text
        self.changed()

    def unsaved(self) -> int:
        """Return how many corrections are in no log."""
        return sum(shown.session.unsaved for shown in self._loaded.values())

    # what is drawn

    def refresh(self) -> None:
        """Draw what has changed."""
        with self.lock, self.served.server.atomic():
            session, look, shown = self.shown.session, self.look, self.shown
            lines = self._clipped(session.state.lines)
            if "roots" in look.layers and self.standing is None:
                shade, _ = colours.colouring(look.colour, session.state.lines)
                key = f"{look.colour} {look.low_mm} {look.high_mm}"
                if look.colour != "end seen or not":
                    key += f" {len(session.log.edits)}"
                self.scene.show_roots(lines, shade, key=key)
            self._draw_surface()
            self._draw_voxels()
            if "canister" in look.layers and shown.dataset is not None and "/rig/canister" not in self.scene:
                self.scene.show_canister(shown.dataset.scene)
            if "cameras" in look.layers and shown.pictures is not None and "/cameras/0" not in self.scene:
                self.scene.show_cameras(shown.pictures, self.stand)
            here = self.standing is None
            for layer, prefix in (("roots", "/roots"), ("canister", "/rig"), ("cameras", "/cameras")):
                self.scene.set_visible(prefix, visible=here and layer in look.layers)
            self._draw_chosen()
        self.changed()

    def _clipped(self, lines: Any) -> dict[int, Line]:
        """Return the parts of roots between two heights."""
        look = self.look
        if look.low_mm < -1e8 and look.high_mm > 1e8:
            return dict(lines)
        found = {}
        for number, line in lines.items():
            inside = np.flatnonzero((line.points_mm[:, 2] >= look.low_mm) & (line.points_mm[:, 2] <= look.high_mm))
            if len(inside) == len(line.points_mm):
                found[number] = line
            elif len(inside) > 1:
                way = line.way_mm
                found[number] = line.between(float(way[inside[0]]), float(way[inside[-1]]))
        return found

    def _draw_surface(self) -> None:
        look, shown = self.look, self.shown
        wanted = "surface" in look.layers and self.standing is None
        compared = "truth" in look.layers and self.standing is None and shown.truth is not None
        coloured = compared and look.truth == TRUTH[2]
        key = (wanted or coloured, coloured, len(shown.session.log.edits), id(shown))
        if key != getattr(self, "_surface_key", None):
            self._surface_key = key
            mesh = shown.surface_now() if wanted or coloured else None
            self.scene.show_surface(mesh, colours=shown.distance_colours(mesh) if mesh is not None and coloured else None)
        truth_key = (compared and not coloured, look.truth, id(shown))
        if truth_key != getattr(self, "_truth_key", None):
            self._truth_key = truth_key
            aside = _ASIDE_MM if look.truth == TRUTH[1] else 0.0
            self.scene.show_surface(shown.truth if truth_key[0] else None, name="/truth", aside_mm=aside)

    def _draw_voxels(self) -> None:
        session, look = self.shown.session, self.look
        wanted = "voxels" in look.layers and self.standing is None
        key = (wanted, look.low_mm, look.high_mm, len(session.log.edits), id(session))
        if key == getattr(self, "_voxel_key", None):
            return
        self._voxel_key = key
        rows = self._voxel_rows() if wanted else np.zeros(0, np.int64)
        solid, volumes = session.solid, session.measure().volumes_mm3
        room = (solid.size[rows] * solid.voxel_mm) ** 3
        self.scene.show_voxels(solid.centre_mm[rows], volumes[rows] / room, solid.voxel_mm)

    def _voxel_rows(self) -> NDArray[np.int64]:
        """Return the voxels that are there and inside the clipping heights."""
        session, look = self.shown.session, self.look
        height = session.solid.centre_mm[:, 2]
        return np.flatnonzero((session.measure().volumes_mm3 > 1e-9) & (height >= look.low_mm) & (height <= look.high_mm))

    def _draw_chosen(self) -> None:
        session = self.shown.session
        self.roots = [number for number in self.roots if number in session.state.lines]
        solid = session.solid
        rows = np.array(sorted(self.voxels), np.int64)
        here = self.standing is None
        self.scene.show_chosen([session.state.lines[k] for k in self.roots] if here else [], solid.centre_mm[rows], solid.voxel_mm)
        self.scene.show_measure(self.measured if here else [])

    # choosing

    def clicked(self, ray: Ray, *, more: bool = False) -> None:
        """Answer a click into the scene.

        Parameters
        ----------
        more : add to what is chosen.
        """
        with self.lock:
            if self.standing is not None:
                return
            if self.look.click == CLICKS[1]:
                self._click_voxel(ray, more=more)
                return
            hit = picking.root_at(self.shown.strung(), ray)
            if hit is None:
                if not more:
                    self.choose_nothing()
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
                self.measured = [*self.measured, point][-2:] if len(self.measured) < 2 else [point]
            else:
                kind = {CLICKS[3]: "cut", CLICKS[4]: "tip", CLICKS[5]: "base"}[self.look.click]
                self.do(kind, roots=[number], point_mm=tuple(float(x) for x in point))
                return
            self._draw_chosen()
        self.changed()

    def _click_voxel(self, ray: Ray, *, more: bool) -> None:
        solid, rows = self.shown.session.solid, self._voxel_rows()
        hit = picking.voxel_at(solid.centre_mm[rows], np.asarray(0.5 * solid.size[rows] * solid.voxel_mm), ray)
        if not more:
            self.voxels.clear()
            self.roots.clear()
        if hit is not None:
            self.voxels ^= {int(rows[hit])}
        self._draw_chosen()
        self.changed()

    def choose_rectangle(self, screen: Screen, low: tuple[float, float], high: tuple[float, float]) -> None:
        """Choose what shows inside a rectangle: voxels where they are shown or clicked, else the roots that lie wholly inside."""
        with self.lock:
            if self.look.click == CLICKS[1] or "voxels" in self.look.layers:
                rows = self._voxel_rows()
                inside = screen.inside(self.shown.session.solid.centre_mm[rows], low, high)
                self.voxels |= {int(row) for row in rows[inside]}
            else:
                lines = self._clipped(self.shown.session.state.lines)
                self.roots += [k for k, line in lines.items() if k not in self.roots and screen.inside(line.points_mm, low, high).all()]
            self._draw_chosen()
        self.changed()

    def choose_box(self, low_mm: Sequence[float], high_mm: Sequence[float]) -> None:
        """Choose the voxels whose middles lie in a box."""
        with self.lock:
            rows = self.shown.session.solid.leaves_in(low_mm, high_mm)
            there = self.shown.session.measure().volumes_mm3[rows] > 1e-9
            self.voxels = {int(row) for row in rows[there]}
            self._draw_chosen()
        self.changed()

    def choose_nothing(self) -> None:
        """Choose nothing."""
        with self.lock:
            self.roots, self.voxels, self.measured = [], set(), []
            self._draw_chosen()
        self.changed()

    # corrections

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
        """Bring the root back that was taken away last."""
        removed = self.shown.session.state.removed
        if not removed:
            self.say("no root was taken away")
            return
        self.do("restore roots", roots=[list(removed)[-1]])

    def fit_again(self) -> None:
        """Fit the roots to the pictures again."""
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

    # pictures

    def stand(self, place: int | None, client: viser.ClientHandle | None = None) -> None:
        """Stand in a picture, with the reconstruction drawn over it through the water; None goes back to 3D."""
        pictures, server = self.shown.pictures, self.served.server
        with self.lock:
            if pictures is None or (place is None and self.standing is None):
                return
            self.standing = None if place is None else place % len(pictures.views)
            self._draw_picture()
            self.refresh()
        clients = server.get_clients().values() if client is None else [client]
        for one in clients:
            with one.atomic():
                if self.standing is None:
                    start = server.initial_camera
                    one.camera.position, one.camera.look_at, one.camera.fov = start.position, start.look_at, start.fov
                else:
                    pose = frames.invert(pictures.views[self.standing].cam_from_canister)
                    one.camera.wxyz, one.camera.position = quaternion(pose[:3, :3]), pose[:3, 3]
                    one.camera.fov = field_of_view(pictures.views[self.standing])

    def _draw_picture(self) -> None:
        server, pictures = self.served.server, self.shown.pictures
        if self.standing is None or pictures is None:
            server.scene.set_background_image(None)
            return
        lines = self.shown.session.state.lines if "roots" in self.look.layers else {}
        orders = colours.order_of(lines)
        shades = {number: colours.ORDERS[min(orders[number], len(colours.ORDERS) - 1)] for number in lines}
        shades |= dict.fromkeys([number for number in self.roots if number in lines], (255, 170, 0))
        server.scene.set_background_image(pictures.drawn(self.standing, lines, shades), format="jpeg", jpeg_quality=90)


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
    from rhizotwin.viewer import panels

    served = guard.serve(host=host, port=port)
    viewer = Viewer(served, folders, dataset)
    panels.build(viewer)
    return viewer

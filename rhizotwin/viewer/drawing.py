"""What browsers see of a result: layers, colours, clipping, what is chosen, and the picture that they stand in."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import viser
from numpy.typing import NDArray

from rhizotwin.corrections.lines import Line
from rhizotwin.recon.results.parts import Mesh
from rhizotwin.scenes import frames
from rhizotwin.scenes.errors import UserError
from rhizotwin.viewer import colours
from rhizotwin.viewer.guard import Served
from rhizotwin.viewer.picking import Strung
from rhizotwin.viewer.scene3d import CANISTER, Scene3d, field_of_view, quaternion
from rhizotwin.viewer.shown import Shown

Array = NDArray[np.float64]
Triple = tuple[float, float, float]
Parts = Mapping[int, tuple[Line, ...]]

LAYERS = ("roots", "surface", "voxels", "canister", "cameras", "truth")
CLICKS = ("choose a root", "choose a voxel", "measure", "cut here", "end it here", "plant begins here")
TRUTH = ("over", "beside", "distance colours")
_ASIDE_MM = 60.0
_APART_S = 0.02
"""What is sent farther apart than viser gathers messages (1/60 s) comes in two parcels."""
_FAR_MM = 1e9
"""Beyond everything."""


@dataclass
class Look:
    """How the result is shown."""

    layers: set[str] = field(default_factory=lambda: {"roots", "canister"})
    """Cameras wait until they are asked for: their pictures would hold up the first picture, and each after it."""
    colour: str = "order"
    truth: str = TRUTH[0]
    low_mm: Triple = (-_FAR_MM, -_FAR_MM, -_FAR_MM)
    high_mm: Triple = (_FAR_MM, _FAR_MM, _FAR_MM)
    """What lies outside of these corners is cut away, canister frame."""
    click: str = CLICKS[0]

    @property
    def whole(self) -> bool:
        """Tell whether nothing is cut away."""
        return max(self.low_mm) <= -_FAR_MM and min(self.high_mm) >= _FAR_MM

    def inside(self, points_mm: Array) -> NDArray[np.bool_]:
        """Tell which points (N, 3) show."""
        return np.asarray(((points_mm >= self.low_mm) & (points_mm <= self.high_mm)).all(axis=1))


class Drawing:
    """Results drawn for browsers, as the state says."""

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
        self._visible: tuple[object, Parts] | None = None
        self._strung: tuple[Parts, Strung] | None = None
        self.on_change: list[Callable[[], None]] = []
        """Called when what the panels say may have changed."""
        self.on_drawn: list[Callable[[], None]] = []
        """Called after that, when the scene has followed: for what takes longer."""
        self._surfaces = ThreadPoolExecutor(max_workers=1, thread_name_prefix="surface")
        """Nobody waits for surfaces: with the next correction they may be old already."""
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
            points = np.concatenate(
                [line.points_mm for line in shown.session.state.lines.values()] or [shown.session.measure().solid.centre_mm]
            )
            self.scene.look_at(points, rim_mm=60.0)
            if not shown.session.state.lines:
                self.look.layers |= {"surface"}
            self.refresh()

    def changed(self) -> None:
        """Let the panels follow."""
        for follow in self.on_change:
            follow()

    def drawn(self) -> None:
        """Let follow what takes longer."""
        for follow in self.on_drawn:
            follow()

    def say(self, text: str) -> None:
        """Tell the user something."""
        self.told = text
        self.changed()

    def unsaved(self) -> int:
        """Return how many corrections are in no log."""
        return sum(shown.session.unsaved for shown in self._loaded.values())

    # what is drawn

    def answer(self) -> None:
        """Let the panels follow, then mark what is chosen."""
        with self.lock:
            self._tell()
            self._draw_chosen()

    def _tell(self) -> None:
        """Let the panels follow at once.

        A browser shows what comes with nothing for the scene beside it before it draws the scene again, which software
        takes long for.
        """
        lines = self.shown.session.state.lines
        self.roots = [number for number in self.roots if number in lines]
        self.changed()
        self.served.server.flush()
        time.sleep(_APART_S)

    def refresh(self) -> None:
        """Let the panels follow, and draw what has changed: a large surface takes longer than the number."""
        with self.lock:
            self._tell()
            self._draw()
        self._surfaces.submit(self._draw_surface_or_say)
        self.drawn()

    def _draw(self) -> None:
        """Draw all but surfaces."""
        with self.served.server.atomic():
            session, look, shown = self.shown.session, self.look, self.shown
            if "roots" in look.layers and self.standing is None:
                shade, _ = colours.colouring(look.colour, session.state.lines)
                key = look.colour if look.colour in colours.OF_ONE else f"{look.colour} {len(session.log.edits)}"
                self.scene.show_roots(self.visible(), shade, key=key)
            self._draw_voxels()
            if "canister" in look.layers and shown.dataset is not None and CANISTER not in self.scene:
                self.scene.show_canister(shown.dataset.scene)
            if "cameras" in look.layers and shown.pictures is not None and "/cameras/0" not in self.scene:
                self.scene.show_cameras(shown.pictures, self.stand)
            here = self.standing is None
            for layer, prefix in (("roots", "/roots"), ("canister", "/rig"), ("cameras", "/cameras")):
                self.scene.set_visible(prefix, visible=here and layer in look.layers)
            self._draw_chosen()

    def cut_away(self, axis: int, low_mm: float | None, high_mm: float | None) -> None:
        """Show only what lies between two places along an axis; None: no end."""
        for name, value, none in (("low_mm", low_mm, -_FAR_MM), ("high_mm", high_mm, _FAR_MM)):
            corner = list(getattr(self.look, name))
            corner[axis] = none if value is None else value
            setattr(self.look, name, tuple(corner))
        self.refresh()

    def visible(self) -> Parts:
        """Return the parts of roots that are not cut away."""
        lines, look = self.shown.session.state.lines, self.look
        key = (id(lines), look.low_mm, look.high_mm)
        if self._visible is None or self._visible[0] != key:
            found = {number: (line,) if look.whole else _parts(line, look.inside(line.points_mm)) for number, line in lines.items()}
            self._visible = key, {number: parts for number, parts in found.items() if parts}
        return self._visible[1]

    def strung(self) -> Strung:
        """Return the nodes of the roots that can be clicked."""
        parts = self.visible()
        if self._strung is None or self._strung[0] is not parts:
            self._strung = parts, Strung.of((number, line) for number, lines in parts.items() for line in lines)
        return self._strung[1]

    def _draw_surface_or_say(self) -> None:
        """Draw surfaces in their own thread, where nobody else hears what goes wrong."""
        try:
            self._draw_surface()
        except UserError as error:
            self.say(str(error))

    def _draw_surface(self) -> None:
        look, shown = self.look, self.shown
        wanted = "surface" in look.layers and self.standing is None
        compared = "truth" in look.layers and self.standing is None and shown.truth is not None
        coloured = compared and look.truth == TRUTH[2]
        key = (wanted or coloured, coloured, len(shown.session.log.edits), id(shown), look.low_mm, look.high_mm)
        if key != getattr(self, "_surface_key", None):
            self._surface_key = key
            mesh = self._cut(shown.surface_now()) if wanted or coloured else None
            self.scene.show_surface(mesh, colours=shown.distance_colours(mesh) if mesh is not None and coloured else None)
        truth_key = (compared and not coloured, look.truth, id(shown), look.low_mm, look.high_mm)
        if truth_key != getattr(self, "_truth_key", None):
            self._truth_key = truth_key
            aside = _ASIDE_MM if look.truth == TRUTH[1] else 0.0
            truth = self._cut(shown.truth) if truth_key[0] and shown.truth is not None else None
            self.scene.show_surface(truth, name="/truth", aside_mm=aside)

    def _cut(self, mesh: Mesh) -> Mesh | None:
        """Return what of a surface is not cut away; None where that is nothing."""
        if self.look.whole:
            return mesh
        faces = mesh.faces[self.look.inside(mesh.vertices_mm)[mesh.faces].all(axis=1)]
        used, index = np.unique(faces, return_inverse=True)
        return Mesh(vertices_mm=mesh.vertices_mm[used], faces=index.reshape(-1, 3)) if len(faces) else None

    def _draw_voxels(self) -> None:
        session, look = self.shown.session, self.look
        wanted = "voxels" in look.layers and self.standing is None
        key = (wanted, look.low_mm, look.high_mm, len(session.log.edits), id(session))
        if key == getattr(self, "_voxel_key", None):
            return
        self._voxel_key = key
        rows = self._voxel_rows() if wanted else np.zeros(0, np.int64)
        measured = session.measure()
        solid, room = measured.solid, (measured.solid.size[rows] * measured.solid.voxel_mm) ** 3
        self.scene.show_voxels(solid.centre_mm[rows], measured.volumes_mm3[rows] / room, solid.voxel_mm)

    def _voxel_rows(self) -> NDArray[np.int64]:
        """Return the voxels that are there and not cut away."""
        measured, look = self.shown.session.measure(), self.look
        there = measured.volumes_mm3 > 1e-9
        if not look.whole:
            there &= look.inside(measured.solid.centre_mm[: len(there)])
        return np.flatnonzero(there)

    def _draw_chosen(self) -> None:
        session = self.shown.session
        solid = session.measure().solid
        rows = np.array(sorted(self.voxels), np.int64)
        here = self.standing is None
        centre_mm = solid.centre_mm[rows] if len(rows) else np.zeros((0, 3))  # all middles take a tenth of a second
        self.scene.show_chosen([session.state.lines[k] for k in self.roots] if here else [], centre_mm, solid.voxel_mm)
        self.scene.show_measure(self.measured if here else [])

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


def _parts(line: Line, inside: NDArray[np.bool_]) -> tuple[Line, ...]:
    """Return the stretches of a root whose nodes show."""
    if inside.all():
        return (line,)
    shown = np.flatnonzero(inside)
    runs = [run for run in np.split(shown, np.flatnonzero(np.diff(shown) > 1) + 1) if len(run) > 1]
    way = line.way_mm
    return tuple(line.between(float(way[run[0]]), float(way[run[-1]])) for run in runs)

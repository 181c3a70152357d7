"""State of the viewer and its display: layers, colours, clipping, selection and displayed picture."""

from __future__ import annotations

import io
import logging
import threading
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray
from PIL import Image

from rhizotwin.corrections.lines import Line
from rhizotwin.drawing import root_colours
from rhizotwin.drawing.through_water import THIN_MM
from rhizotwin.recon.results.parts import Mesh
from rhizotwin.scenes import frames
from rhizotwin.scenes.formatting import continued, error_sentence, is_expected
from rhizotwin.scenes.threads import Worker
from rhizotwin.stored import result_names
from rhizotwin.viewer.guard import Served
from rhizotwin.viewer.look import FAR_MM, TRUTH, Look
from rhizotwin.viewer.picking import Nodes
from rhizotwin.viewer.scene3d import CANISTER, Scene3d, field_of_view, quaternion
from rhizotwin.viewer.shown import Shown

Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]
Parts = Mapping[int, tuple[Line, ...]]

BESIDE_PX = 960
"""Maximum width of the picture beside the 3D view, px. Its window has 264 px, or 792 on a fine screen, and can be
enlarged."""
_ASIDE_MM = 60.0
"""Distance between the reconstructed and the true shape if they are displayed side by side, mm."""
_APART_S = 0.02
"""Time between two messages that browsers must receive separately, s. It is longer than the interval in which viser
collects messages (1/60 s)."""


class Drawing:
    """State of the viewer, and methods that display this state in browsers."""

    def __init__(self, served: Served, folders: Sequence[Path], dataset: Path | None = None, *, temporary: Collection[Path] = ()) -> None:
        self.served, self.look = served, Look()
        self.scene = Scene3d(served.server)
        self._folders, self._dataset, self._temporary = list(folders), dataset, temporary
        self._loaded: dict[int, Shown] = {}
        self.place = 0
        """Index of the displayed result."""
        self.lock = threading.RLock()
        self.roots: list[int] = []
        """Numbers of the selected roots in the order of selection."""
        self.voxels: set[int] = set()
        """Indices of the selected voxels in the arrays of the shape."""
        self.measured: list[Array] = []
        """Points (3,) of the distance measurement, mm."""
        self.picture: int | None = None
        """Index of the picture that is displayed in place of the 3D view. It is None while the 3D view is displayed."""
        self.beside = 0
        """Index of the picture beside the 3D view."""
        self._followed: tuple[int, ...] = ()
        """Selection for which the picture beside the 3D view was chosen."""
        self._visible: tuple[object, Parts] | None = None
        self._nodes: tuple[Parts, Nodes] | None = None
        self._keys: dict[str, object] = {}
        """State of each layer when it was last drawn, keyed by layer name. A layer is drawn again only if its state has
        changed."""
        self.on_change: list[Callable[[], None]] = []
        """Functions to call after a change that the panels may have to show."""
        self.on_measured: list[Callable[[], None]] = []
        """Functions to call when traits may have changed. They run in the background."""
        self.on_beside: list[Callable[[bytes], None]] = []
        """Functions to call with the picture beside the 3D view (JPEG) when it has changed, in the background."""
        self._background = Worker(name="surface", on_error=self.report)
        """Background thread that draws surfaces. Corrections do not wait for this thread."""
        self.message = ""
        """Last message to the user."""
        self.load(0)

    @property
    def shown(self) -> Shown:
        """Return the result that is currently displayed."""
        return self._loaded[self.place]

    @property
    def names(self) -> list[str]:
        """Return the names of all results that can be selected."""
        return result_names.names_of(self._folders)

    def load(self, place: int) -> None:
        """Display the result with index ``place``.

        Raises
        ------
        UserError
            If the result cannot be displayed. The previous result is still displayed.
        """
        with self.lock:
            if place not in self._loaded:
                folder = self._folders[place]
                shown = Shown(folder, self._dataset, temporary=folder in self._temporary)
                _ = shown.dataset  # raises the error of a wrong dataset while the previous result is still displayed
                self._loaded[place] = shown
            self.place, self.message = place, ""
            self.roots, self.voxels, self.measured = [], set(), []
            self.scene.clear()
            self._keys.clear()
            self.picture, self.beside, self._followed = None, 0, ()
            self.served.server.scene.set_background_image(None)
            lines = self.shown.session.state.lines.values()
            points = np.concatenate([line.points_mm for line in lines] or [self.shown.session.measure().solid.centre_mm])
            self.scene.set_home(points)
            if self.has_gaps:
                self.look.layers |= {"centre lines"}
            self.refresh()

    @property
    def has_gaps(self) -> bool:
        """Return whether most roots are so thin that their surface has gaps.

        The gaps are filled by displaying centre lines.
        """
        lines = self.shown.session.state.lines.values()
        return bool(lines) and float(np.median(np.concatenate([line.diameters_mm for line in lines]))) < THIN_MM

    def changed(self) -> None:
        """Update the panels of all browsers."""
        for follow in self.on_change:
            follow()

    def notify(self, text: str) -> None:
        """Show a message to the user."""
        self.message = text
        self.changed()

    def report(self, error: BaseException) -> None:
        """Show an error as a message, although a panel may be its cause."""
        if not is_expected(error):
            logging.getLogger(__name__).error("the viewer continues after an unexpected error", exc_info=error)
        self.message = continued(error_sentence(error), "view")
        for follow in self.on_change:
            with suppress(Exception):
                follow()

    def unsaved(self) -> int:
        """Return the number of unsaved corrections in all results."""
        return sum(shown.session.unsaved for shown in self._loaded.values())

    # drawing

    def show_selection(self) -> None:
        """Update the panels and highlight the selection."""
        with self.lock:
            self._choose_picture()
            self._update_panels()
            self._draw_selection()
        self._background.submit(self._draw_beside)

    def _choose_picture(self) -> None:
        """Choose the picture in which a newly selected root appears longest as the picture beside the 3D view."""
        pictures, selected = self.shown.pictures, tuple(self.roots)
        if len(selected) == 1 and selected != self._followed and pictures is not None and self.picture is None:
            self.beside = pictures.best_for(self.shown.session.state.lines[selected[0]], 1)[0]
        self._followed = selected

    def _draw_beside(self) -> None:
        """Draw the picture beside the 3D view, with the selected roots. This method runs in the background."""
        pictures, shown, place = self.shown.pictures, self.shown, self.beside
        if pictures is None or not self._is_new("beside", (place, tuple(self.roots), *self._edited)):
            return
        image = pictures.draw_outline(place, shown.surface(), shown.session.state.lines, selected=self.roots, thickness=4)
        stream, small = io.BytesIO(), Image.fromarray(image)
        small.thumbnail((BESIDE_PX, BESIDE_PX))
        small.save(stream, "JPEG", quality=85)
        for follow in self.on_beside:
            follow(stream.getvalue())

    def step_picture(self, step: int) -> None:
        """Go a number of pictures forward, or backward if it is negative."""
        pictures = self.shown.pictures
        if pictures is None:
            return
        self.beside = (self.beside + step) % len(pictures.views)
        if self.picture is None:
            self._background.submit(self._draw_beside)
        else:
            self.enter_picture(self.beside)

    def _update_panels(self) -> None:
        """Update the panels with a separate message. Browsers apply this message before they draw the next frame."""
        lines = self.shown.session.state.lines
        self.roots = [number for number in self.roots if number in lines]
        self.changed()
        self.served.server.flush()
        time.sleep(_APART_S)

    def refresh(self) -> None:
        """Update the panels and draw everything that changed. Surfaces are drawn in the background."""
        with self.lock:
            self._update_panels()
            self._draw()
        self._background.submit(self._finish)

    def _finish(self) -> None:
        """Draw surfaces and update traits. This method runs in the background."""
        self._draw_surface()
        self._draw_beside()
        for follow in self.on_measured:
            follow()

    def wait(self) -> None:
        """Wait until surfaces are drawn and traits are measured."""
        self._background.wait()

    @property
    def _edited(self) -> tuple[object, ...]:
        return id(self.shown), self.shown.session.log.edits

    def _draw(self) -> None:
        """Draw everything except surfaces. Until a surface is up to date, tubes are displayed in its place."""
        with self.served.server.atomic():
            session, look, shown = self.shown.session, self.look, self.shown
            here = self.picture is None
            waiting = here and "surface" in look.layers and self._keys.get("edits of surface") != self._edited
            with_tubes = "tubes" in look.layers or waiting
            shade, _ = root_colours.colour_roots(look.colour, session.state.lines)
            if with_tubes and here:
                key = look.colour if look.colour in root_colours.PER_ROOT else f"{look.colour} {len(session.log.edits)}"
                self.scene.show_roots(self.visible(), shade, key=key)
                if self._is_new("links", (look.is_unclipped, *self._edited)):
                    self.scene.show_links(session.state.lines if look.is_unclipped else {})
            if self._is_new("lines", ("centre lines" in look.layers, look.colour, look.low_mm, look.high_mm, *self._edited)):
                self.scene.show_centre_lines(self.visible() if "centre lines" in look.layers else {}, shade)
            self._draw_voxels()
            if "canister" in look.layers and shown.dataset is not None and CANISTER not in self.scene:
                self.scene.show_canister(shown.dataset.scene)
            if "cameras" in look.layers and shown.pictures is not None and "/cameras/0" not in self.scene:
                self.scene.show_cameras(shown.pictures, self.enter_picture)
            if self._is_new("scale", (here and "scale bar" in look.layers, id(shown))):
                self.scene.show_scale_bar(visible=here and "scale bar" in look.layers)
            self.scene.set_visible("/roots", visible=here and with_tubes)
            self.scene.set_visible("/surface", visible=here and not waiting)
            for layer, prefix in (("centre lines", "/lines"), ("canister", "/rig"), ("cameras", "/cameras")):
                self.scene.set_visible(prefix, visible=here and layer in look.layers)
            self._draw_selection()

    def _is_new(self, layer: str, state: object) -> bool:
        """Return whether the state of a layer has changed since it was last drawn, and store the new state."""
        if self._keys.get(layer) == state:
            return False
        self._keys[layer] = state
        return True

    def clip(self, axis: int, low_mm: float | None, high_mm: float | None) -> None:
        """Limit the display to a range of coordinates along an axis, mm. None stands for no limit."""
        for name, value, none in (("low_mm", low_mm, -FAR_MM), ("high_mm", high_mm, FAR_MM)):
            corner = list(getattr(self.look, name))
            corner[axis] = none if value is None else value
            setattr(self.look, name, tuple(corner))
        self.refresh()

    def visible(self) -> Parts:
        """Return the parts of each root that lie inside the clipping box, keyed by root number."""
        lines, look = self.shown.session.state.lines, self.look
        key = (id(lines), look.low_mm, look.high_mm)
        if self._visible is None or self._visible[0] != key:
            found = {
                number: (line,) if look.is_unclipped else _clip_line(line, look.inside(line.points_mm)) for number, line in lines.items()
            }
            self._visible = key, {number: parts for number, parts in found.items() if parts}
        return self._visible[1]

    def nodes(self) -> Nodes:
        """Return the nodes of the visible roots, among which a clicked root is found."""
        parts = self.visible()
        if self._nodes is None or self._nodes[0] is not parts:
            self._nodes = parts, Nodes.of((number, line) for number, lines in parts.items() for line in lines)
        return self._nodes[1]

    def _draw_surface(self) -> None:
        look, shown = self.look, self.shown
        here, edited = self.picture is None, self._edited
        compared = here and "truth" in look.layers and shown.truth is not None
        by_distance = compared and look.truth == TRUTH[2]
        wanted = here and ("surface" in look.layers or by_distance)
        translucent = "centre lines" in look.layers and not self.has_gaps
        how = "distance" if by_distance else look.colour
        if self._is_new("surface", (wanted, how, translucent, look.low_mm, look.high_mm, edited)):
            mesh = self._clip_mesh(shown.surface()) if wanted else None
            colours = None if mesh is None else shown.distance_colours(mesh) if by_distance else self._surface_colours(mesh)
            if self._edited == edited:  # otherwise a later correction draws the surface
                self.scene.show_surface(mesh, colours, translucent=translucent)
                self._keys["edits of surface"] = edited if wanted else None
                with self.lock:
                    self._draw()
        if self._is_new("truth", (compared and not by_distance, look.truth, id(shown), look.low_mm, look.high_mm)):
            truth = self._clip_mesh(shown.truth) if compared and not by_distance and shown.truth is not None else None
            self.scene.show_truth(truth, aside_mm=_ASIDE_MM if look.truth == TRUTH[1] else 0.0)

    def _surface_colours(self, mesh: Mesh) -> Bytes | None:
        """Return the colours (V, 3) of the vertices of a surface.

        Each vertex has the colour of the nearest point of a centre line. Return None if there are no roots.
        """
        lines = self.shown.session.state.lines
        shade, _ = root_colours.colour_roots(self.look.colour, lines)
        return root_colours.colour_surface(mesh.vertices_mm, lines, shade) if lines else None

    def _clip_mesh(self, mesh: Mesh) -> Mesh | None:
        """Return the part of a mesh that lies inside the clipping box. Return None if no face does."""
        if self.look.is_unclipped:
            return mesh
        faces = mesh.faces[self.look.inside(mesh.vertices_mm)[mesh.faces].all(axis=1)]
        used, index = np.unique(faces, return_inverse=True)
        return Mesh(vertices_mm=mesh.vertices_mm[used], faces=index.reshape(-1, 3)) if len(faces) else None

    def _draw_voxels(self) -> None:
        session, look = self.shown.session, self.look
        wanted = "voxels" in look.layers and self.picture is None
        if not self._is_new("voxels", (wanted, look.low_mm, look.high_mm, *self._edited)):
            return
        rows = self.voxel_rows() if wanted else np.zeros(0, np.int64)
        measured = session.measure()
        solid, room = measured.solid, (measured.solid.size[rows] * measured.solid.voxel_mm) ** 3
        self.scene.show_voxels(solid.centre_mm[rows], measured.volumes_mm3[rows] / room, solid.voxel_mm)

    def voxel_rows(self) -> NDArray[np.int64]:
        """Return the indices of the occupied voxels inside the clipping box."""
        measured, look = self.shown.session.measure(), self.look
        there = measured.volumes_mm3 > 1e-9
        if not look.is_unclipped:
            there &= look.inside(measured.solid.centre_mm[: len(there)])
        return np.flatnonzero(there)

    def _draw_selection(self) -> None:
        session = self.shown.session
        solid = session.measure().solid
        rows = np.array(sorted(self.voxels), np.int64)
        here = self.picture is None
        centre_mm = solid.centre_mm[rows] if len(rows) else np.zeros((0, 3))  # computing all centres takes 0.1 s
        self.scene.show_selected([session.state.lines[k] for k in self.roots] if here else [], centre_mm, solid.voxel_mm)
        self.scene.show_measure(self.measured if here else [])

    # pictures

    def enter_picture(self, place: int | None, client: viser.ClientHandle | None = None) -> None:
        """Display a picture with the outline of the reconstruction, as seen by the camera of the picture.

        If ``place`` is None, return to the 3D view.
        """
        pictures, server = self.shown.pictures, self.served.server
        with self.lock:
            if pictures is None or (place is None and self.picture is None):
                return
            self.picture = None if place is None else place % len(pictures.views)
            self.beside = self.beside if self.picture is None else self.picture
        if self.picture is not None:
            self.shown.surface()  # may take seconds, therefore computed without the lock
        with self.lock:
            self._draw_picture()
            self.refresh()
        clients = server.get_clients().values() if client is None else [client]
        for one in clients:
            with one.atomic():
                if self.picture is None:
                    start = server.initial_camera
                    one.camera.position, one.camera.look_at, one.camera.fov = start.position, start.look_at, start.fov
                else:
                    pose = frames.invert(pictures.views[self.picture].cam_from_canister)
                    one.camera.wxyz, one.camera.position = quaternion(pose[:3, :3]), pose[:3, 3]
                    one.camera.fov = field_of_view(pictures.views[self.picture])

    def _draw_picture(self) -> None:
        server, pictures, shown = self.served.server, self.shown.pictures, self.shown
        if self.picture is None or pictures is None:
            server.scene.set_background_image(None)
            return
        image = pictures.draw_outline(self.picture, shown.surface(), shown.session.state.lines, selected=self.roots)
        server.scene.set_background_image(image, format="jpeg", jpeg_quality=90)


def _clip_line(line: Line, inside: NDArray[np.bool_]) -> tuple[Line, ...]:
    """Return the parts of a root whose nodes lie inside the clipping box."""
    if inside.all():
        return (line,)
    way = line.way_mm
    return tuple(line.between(float(way[first]), float(way[last])) for first, last in line.stretches(inside))


def set_value(handle: Any, value: object) -> None:
    """Set the value of a panel element. The attribute is read-only according to viser's type annotations."""
    handle.value = value

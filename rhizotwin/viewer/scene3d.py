"""3D scene of the viewer: surface, centre lines, tubes, voxels, canister, cameras, truth and scale bar."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import viser
from numpy.typing import NDArray

from rhizotwin.corrections.lines import Line, Lines
from rhizotwin.drawing import root_colours
from rhizotwin.drawing.normals import unit_normals
from rhizotwin.drawing.root_colours import Colouring
from rhizotwin.drawing.through_water import Pictures
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.results.parts import Mesh
from rhizotwin.scenes import frames
from rhizotwin.scenes.model import Scene
from rhizotwin.viewer import tubes
from rhizotwin.viewer.glb import Triangles, concatenate, glb

Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]

CHUNK = 64
"""Maximum number of roots in one mesh. Roots are divided among several meshes, so that only the meshes that a
correction changed must be sent to browsers."""
MOST_TRIANGLES = 400_000
"""Maximum total number of triangles of all tubes. Tubes have fewer corners if there are many roots."""
CANISTER = "/rig/canister"
"""Name of the canister in the scene."""
_CORNERS = (tubes.MOST, 8, 6, 5, 4, 3)
_TRUTH_RGB = (108, 158, 205)
_VOXEL_RGB = np.array([150, 110, 70], np.uint8)
_FRUSTUM_MM = 18.0
_BLACK = (40, 40, 40)
_GREY = (125, 125, 125)
"""Colour of lines that have the same contrast to a light and to a dark background."""
_AMBIENT = 1.6
"""Intensity of the ambient light. It is added to the lights of viser (3.0 from above, 0.4 from below), so that colours
can be recognized on the sides of roots."""
_LIGHT = np.array([0.5, -0.45, 0.74])
_OPACITY = 110
"""Opacity, 0 to 255, of a surface through which centre lines are visible."""
VIEWS: dict[str, tuple[float, float, float]] = {
    "Reset": (1.15, -0.75, 0.35),
    "Front": (1.0, 0.0, 0.0),
    "Side": (0.0, -1.0, 0.0),
    "Top": (1e-3, 0.0, 1.0),
}
"""Direction from the shape to the camera in each preset view, keyed by name of the view."""


class Scene3d:
    """3D scene of a displayed result."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._chunks: dict[int, tuple[list[Line], str]] = {}
        self._handles: dict[str, viser.SceneNodeHandle] = {}
        self.home: tuple[Array, Array] = np.zeros(3), np.ones(3)
        """Centre (3,) and half extents (3,) of the shape, mm."""
        server.scene.set_up_direction("+z")
        server.scene.world_axes.visible = False
        # Shadows and viser's environment map contain no information and halve the frame rate on a laptop.
        server.scene.configure_default_lights(cast_shadow=False)
        server.scene.configure_environment_map(None)
        server.scene.add_light_ambient("/light", intensity=_AMBIENT)

    def set_home(self, points_mm: Array) -> None:
        """Set the initial camera for new browsers so that all points are visible."""
        low, high = points_mm.min(axis=0), points_mm.max(axis=0)
        self.home = (low + high) / 2.0, np.maximum((high - low) / 2.0, 2.0)
        start = self._server.initial_camera
        start.fov, start.near, start.far = np.deg2rad(40.0), 1.0, 5000.0
        start.look_at, start.position = self.home[0], self.camera_position("Reset")

    def camera_position(self, view: str, *, aspect: float = 1.0) -> Array:
        """Return the camera position (3,), mm, of a preset view. The whole shape is visible from there."""
        middle, half = self.home
        toward = np.array(VIEWS[view]) / np.linalg.norm(VIEWS[view])
        right = np.cross([0.0, 0.0, 1.0], toward)
        right /= np.linalg.norm(right)
        wide, high, deep = (float(np.abs(axis) @ half) for axis in (right, np.cross(toward, right), toward))
        return np.asarray(middle + toward * (deep + 1.05 * max(high, wide / min(aspect, 1.0)) / np.tan(np.deg2rad(20.0))))

    def show_roots(self, lines: Mapping[int, Sequence[Line]], colours: Colouring, *, key: str) -> None:
        """Draw roots as tubes. Meshes whose roots and colours have not changed are kept.

        Parameters
        ----------
        lines : mapping of int to sequence of Line
            Visible parts of each root, by number.
        colours : callable
            Function that returns the colours of the points of a root.
        key : str
            Identifier of the colours. All roots are redrawn if it changes.
        """
        nodes = sum(len(line.points_mm) for parts in lines.values() for line in parts)
        most = next((n for n in _CORNERS if 2 * n * nodes <= MOST_TRIANGLES), _CORNERS[-1])
        groups: dict[int, list[int]] = {}
        for number in lines:
            groups.setdefault(number // CHUNK, []).append(number)
        for gone in set(self._chunks) - set(groups):
            self.drop(f"/roots/{gone}")
            del self._chunks[gone]
        for chunk, numbers in groups.items():
            named = [(number, line) for number in numbers for line in lines[number]]
            now = [line for _, line in named]
            before = self._chunks.get(chunk)
            if before is not None and before[1] == key and list(map(id, before[0])) == list(map(id, now)):
                continue
            self._add_triangles(f"/roots/{chunk}", tubes.mesh_lines(now, [colours(*one) for one in named], most=most))
            self._chunks[chunk] = (now, key)

    def show_links(self, lines: Lines) -> None:
        """Draw thin lines across the gaps between laterals and their parents.

        Laterals whose first part no picture shows begin beside their parents. Each line leads to the parent's nearest
        point. An empty mapping removes the lines.
        """
        self.drop("/roots/links")
        ends = []
        for line in lines.values():
            parent = lines.get(line.parent)
            if parent is None:
                continue
            away_mm = np.linalg.norm(parent.points_mm - line.points_mm[0], axis=1)
            nearest = int(away_mm.argmin())
            if away_mm[nearest] > parent.diameters_mm[nearest] / 2.0 + tubes.OFF_MM:
                ends.append((line.points_mm[0], parent.points_mm[nearest]))
        if ends:
            add = self._server.scene.add_line_segments
            self._keep("/roots/links", add("/roots/links", np.array(ends), _GREY, thickness=1.5, thickness_units="screen"))

    def show_selected(self, lines: Sequence[Line], voxels_mm: Array, voxel_mm: float) -> None:
        """Highlight the selected roots and voxels."""
        self.drop("/selected/roots")
        self.drop("/selected/voxels")
        if lines:
            wider = [replace(line, diameters_mm=1.25 * line.diameters_mm + 0.05) for line in lines]
            shades = [np.tile(np.array(root_colours.SELECTED, np.uint8), (len(line.points_mm), 1)) for line in lines]
            self._add_triangles("/selected/roots", tubes.mesh_lines(wider, shades))
        if len(voxels_mm):
            self._keep(
                "/selected/voxels", self._points("/selected/voxels", voxels_mm, np.array(root_colours.SELECTED, np.uint8), 1.1 * voxel_mm)
            )

    def show_voxels(self, centre_mm: Array, share: Array, voxel_mm: float) -> None:
        """Draw voxels as shaded squares, whose colours are more saturated for higher occupancies."""
        self.drop("/voxels")
        if len(centre_mm):
            light = 0.45 + 0.55 * np.maximum(_outward_directions(centre_mm, share) @ _LIGHT, 0.0)
            colours = np.asarray(light[:, None] * (255 - np.clip(share, 0.15, 1.0)[:, None] * (255 - _VOXEL_RGB)), np.uint8)
            self._keep("/voxels", self._points("/voxels", centre_mm, colours, voxel_mm))

    def show_surface(self, mesh: Mesh | None, colours: Bytes | None = None, *, name: str = "/surface", translucent: bool = False) -> None:
        """Draw a surface with the given colours (V, 3) of its vertices. If ``mesh`` is None, the surface is removed."""
        self.drop(name)
        if mesh is None or not len(mesh.faces):
            return
        shades = np.tile(np.array(root_colours.SURFACE, np.uint8), (len(mesh.vertices_mm), 1)) if colours is None else colours
        if translucent:
            shades = np.column_stack([shades, np.full(len(shades), _OPACITY, np.uint8)])
        self._add_triangles(name, Triangles(mesh.vertices_mm, unit_normals(mesh), mesh.faces, shades))

    def show_truth(self, mesh: Mesh | None, *, aside_mm: float) -> None:
        """Draw the true surface, translucent and shifted along y. If ``mesh`` is None, the true surface is removed."""
        if mesh is not None:
            mesh = Mesh(vertices_mm=mesh.vertices_mm + np.array([0.0, aside_mm, 0.0]), faces=mesh.faces)
        colours = None if mesh is None else np.tile(np.array(_TRUTH_RGB, np.uint8), (len(mesh.vertices_mm), 1))
        self.show_surface(mesh, colours, name="/truth", translucent=True)

    def show_centre_lines(self, lines: Mapping[int, Sequence[Line]], colours: Colouring) -> None:
        """Draw centre lines with a width of two pixels, darker than the surface. An empty mapping removes them."""
        self.drop("/lines")
        parts = [(number, line) for number, several in lines.items() for line in several]
        if parts:
            points = np.concatenate([np.stack([line.points_mm[:-1], line.points_mm[1:]], axis=1) for _, line in parts])
            shades = np.concatenate([colours(number, line)[:-1] for number, line in parts])
            dark = np.repeat((0.5 * shades).astype(np.uint8)[:, None], 2, axis=1)
            self._keep("/lines", self._server.scene.add_line_segments("/lines", points, dark, thickness=2.0, thickness_units="screen"))

    def show_scale_bar(self, *, visible: bool) -> None:
        """Draw a vertical scale bar next to the shape. Its length is 1, 2 or 5 times a power of ten."""
        self.drop("/scale/bar")
        self.drop("/scale/label")
        if not visible:
            return
        middle, half = self.home
        power = 10.0 ** np.floor(np.log10(half[2]))
        length = next(k * power for k in (5.0, 2.0, 1.0) if k * power <= half[2])
        foot = middle + np.array([0.0, 1.2 * half[1] + 3.0, -half[2]])
        ends = foot + np.outer([0.0, 1.0], [0.0, 0.0, length])
        tick = np.array([0.0, 0.04 * length, 0.0])
        points, add = np.stack([ends, *(np.stack([end - tick, end + tick]) for end in ends)]), self._server.scene
        self._keep("/scale/bar", add.add_line_segments("/scale/bar", points, _GREY, thickness=3.0, thickness_units="screen"))
        beside = ends.mean(axis=0) + 2.0 * tick
        self._keep("/scale/label", add.add_label("/scale/label", f"{length:g} mm", position=beside, anchor="center-left"))

    def show_canister(self, scene: Scene) -> None:
        """Draw canister, water, net pot and marker strip."""
        can, pot, strip = scene.canister, scene.net_pot, scene.strip
        level = scene.water.level_mm
        parts = [
            _wall(radius, low, high, colour)
            for radius, low, high, colour in (
                (can.inner_radius_mm, level, 0.0, (190, 200, 205, 60)),
                (can.inner_radius_mm, can.floor_z_mm, level, (140, 185, 220, 90)),
                (pot.outer_radius_mm, pot.skirt_bottom_mm, pot.top_mm, (215, 215, 215, 150)),
            )
        ]
        for row in range(strip.rows):
            for column in range(strip.columns):
                low = strip.bottom_mm + row * strip.row_pitch_mm
                half = strip.marker_mm / pot.outer_radius_mm / 2.0
                middle = (column + 0.5) * 2.0 * np.pi / strip.columns
                ends = middle - half, middle + half
                parts.append(_wall(pot.outer_radius_mm - 0.2, low, low + strip.marker_mm, (*_BLACK, 204), *ends, steps=3))
        parts.append(_disc(can.inner_radius_mm, can.floor_z_mm, (150, 170, 185, 110)))
        self._add_triangles(CANISTER, concatenate(parts), lit=False)

    def show_cameras(self, pictures: Pictures, clicked: Callable[[int, viser.ClientHandle], None]) -> None:
        """Draw the cameras with their pictures. A click on a camera calls ``clicked``."""
        for place, view in enumerate(pictures.views):
            high = view.camera.image_wh[1]
            handle = self.show_camera(str(place), view, pictures.picture(place)[:: max(1, high // 90), :: max(1, high // 90)])

            def on_click(event: viser.SceneNodePointerEvent[viser.CameraFrustumHandle], place: int = place) -> None:
                clicked(place, event.client)

            handle.on_click(on_click)

    def show_camera(self, name: str, view: View, image: Bytes) -> viser.CameraFrustumHandle:
        """Draw a camera with its picture (H, W, 3)."""
        width, height = view.camera.image_wh
        pose = frames.invert(view.cam_from_canister)
        handle = self._server.scene.add_camera_frustum(
            f"/cameras/{name}",
            fov=field_of_view(view),
            aspect=width / height,
            scale=_FRUSTUM_MM,
            thickness=0.5,
            color=(31, 95, 139),
            image=image,
            wxyz=quaternion(pose[:3, :3]),
            position=pose[:3, 3],
            cast_shadow=False,
            receive_shadow=False,
        )
        self._keep(f"/cameras/{name}", handle)
        return handle

    def show_measure(self, points_mm: Sequence[Array]) -> None:
        """Draw the points of a distance measurement and the line between them."""
        self.drop("/measure/points")
        self.drop("/measure/line")
        if points_mm:
            self._keep("/measure/points", self._points("/measure/points", np.array(points_mm), np.array([220, 30, 30], np.uint8), 0.8))
        if len(points_mm) == 2:
            line = self._server.scene.add_line_segments("/measure/line", np.array([points_mm]), (220, 30, 30), thickness=0.25)
            self._keep("/measure/line", line)

    def set_visible(self, prefix: str, *, visible: bool) -> None:
        """Show or hide all objects whose names have a prefix."""
        for name, handle in self._handles.items():
            if name.startswith(prefix) and handle.visible != visible:
                handle.visible = visible

    def __contains__(self, name: str) -> bool:
        return name in self._handles

    def clear(self) -> None:
        """Remove all objects."""
        for name in list(self._handles):
            self.drop(name)
        self._chunks.clear()

    def _add_triangles(self, name: str, triangles: Triangles, *, lit: bool = True) -> None:
        data = glb(triangles, lit=lit)
        self._keep(name, self._server.scene.add_glb(name, data, cast_shadow=False, receive_shadow=False))

    def _points(self, name: str, points_mm: Array, colours: Bytes, size_mm: float) -> viser.SceneNodeHandle:
        return self._server.scene.add_point_cloud(
            name, points_mm.astype(np.float32), colours, point_size=size_mm, point_shape="square", precision="float32", point_shading="flat"
        )

    def _keep(self, name: str, handle: viser.SceneNodeHandle) -> None:
        self._handles[name] = handle

    def drop(self, name: str) -> None:
        """Remove an object, if it exists."""
        handle = self._handles.pop(name, None)
        if handle is not None:
            handle.remove()


def field_of_view(view: View) -> float:
    """Return the vertical field of view of a picture, rad."""
    return 2.0 * float(np.arctan(view.camera.image_wh[1] / 2.0 / view.camera.focal_px[1]))


def quaternion(rotation: Array) -> Array:
    """Return the quaternion (w, x, y, z) of a rotation matrix (3, 3)."""
    return np.asarray(viser.transforms.SO3.from_matrix(rotation).wxyz)


def _outward_directions(centre_mm: Array, share: Array, *, neighbours: int = 24) -> Array:
    """Return the direction (N, 3) in which the surface of the shape faces at each voxel.

    It is a unit vector that points away from the occupied neighbours of the voxel.
    """
    from scipy.spatial import cKDTree  # loaded on first use

    count = min(neighbours, len(centre_mm))
    _, near = cKDTree(centre_mm).query(centre_mm, count, workers=-1)
    near = near.reshape(len(centre_mm), count)
    away = ((centre_mm[:, None] - centre_mm[near]) * share[near][..., None]).sum(axis=1)
    return np.asarray(away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9))


def _wall(
    radius: float,
    low: float,
    high: float,
    colour: tuple[int, int, int, int],
    begin: float = 0.0,
    end: float = 2.0 * np.pi,
    steps: int = 72,
) -> Triangles:
    """Return part of the wall of a cylinder about the z axis.

    The wall is visible from the inside only, so that its near half hides no roots.
    """
    angle = np.linspace(begin, end, steps + 1)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    vertices = np.concatenate([np.column_stack([radius * ring, np.full(len(ring), z)]) for z in (low, high)])
    inward = np.tile(np.column_stack([-ring, np.zeros(len(ring))]), (2, 1))
    a, up = np.arange(steps), steps + 1
    faces = np.concatenate([np.stack([a + 1, a, a + 1 + up], axis=1), np.stack([a + 1 + up, a, a + up], axis=1)])
    return Triangles(vertices, inward, faces, np.tile(np.array(colour, np.uint8), (len(vertices), 1)))


def _disc(radius: float, z: float, colour: tuple[int, int, int, int], steps: int = 72) -> Triangles:
    """Return a horizontal disc that is visible from above."""
    angle = np.linspace(0.0, 2.0 * np.pi, steps, endpoint=False)
    vertices = np.concatenate([[[0.0, 0.0, z]], np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(steps, z)], axis=1)])
    a = np.arange(steps)
    faces = np.stack([np.zeros(steps, np.int64), a + 1, (a + 1) % steps + 1], axis=1)
    count = len(vertices)
    return Triangles(vertices, np.tile([0.0, 0.0, 1.0], (count, 1)), faces, np.tile(np.array(colour, np.uint8), (count, 1)))

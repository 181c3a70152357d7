"""What stands in the 3D view: roots, surface, voxels, canister, cameras, truth."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import viser
from numpy.typing import NDArray

from rhizotwin import shading
from rhizotwin.corrections.lines import Line
from rhizotwin.recon.optics.cameras import View
from rhizotwin.recon.results.parts import Mesh
from rhizotwin.scenes import frames
from rhizotwin.scenes.model import Scene
from rhizotwin.through_water import Pictures
from rhizotwin.viewer import tubes
from rhizotwin.viewer.glb import Triangles, glb, joined

Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]
Colouring = Callable[[int, Line], Bytes]

CHUNK = 64
"""Roots drawn as one mesh: a correction sends only the meshes that it changes."""
MOST_TRIANGLES = 400_000
"""More are drawn with fewer corners a tube, or coarser; a laptop draws this many without effort."""
CANISTER = "/rig/canister"
_CORNERS = (tubes.MOST, 8, 6, 5, 4, 3)
_SURFACE_RGB = (222, 160, 92)
_TRUTH_RGB = (108, 158, 205)
_CHOSEN_RGB = (255, 210, 0)
_VOXEL_RGB = np.array([150, 110, 70], np.uint8)
_FRUSTUM_MM = 18.0
_BLACK = (40, 40, 40)
_AMBIENT = 1.6
"""With viser's lamps (3.0 from above, 0.4 from below) the flanks of hanging roots then keep their colours."""


class Scene3d:
    """The 3D view of one result, kept up to date."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._chunks: dict[int, tuple[list[Line], str]] = {}
        self._handles: dict[str, viser.SceneNodeHandle] = {}
        server.scene.set_up_direction("+z")
        server.scene.world_axes.visible = False
        # Shadows, and the picture of a hall that viser lights things by, tell nothing and halve a laptop's frames.
        server.scene.configure_default_lights(cast_shadow=False)
        server.scene.configure_environment_map(None)
        server.scene.add_light_ambient("/light", intensity=_AMBIENT)

    def look_at(self, points_mm: Array, *, rim_mm: float) -> None:
        """Let new browsers begin with all points in view."""
        low, high = points_mm.min(axis=0), points_mm.max(axis=0)
        middle, reach = (low + high) / 2.0, max(float(np.linalg.norm(high - low)), 0.2 * rim_mm)
        start = self._server.initial_camera
        start.look_at, start.fov, start.near, start.far = middle, np.deg2rad(40.0), 1.0, 5000.0
        start.position = middle + np.array([1.15, -0.75, 0.35]) * reach

    def show_roots(self, lines: Mapping[int, Sequence[Line]], colours: Colouring, *, key: str) -> None:
        """Draw roots as tubes; chunks that are as they were stay.

        Parameters
        ----------
        lines : mapping of int to sequence of Line
            The parts of each root that show.
        key : str
            Changes where the colours do.
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
            self._add_triangles(f"/roots/{chunk}", tubes.of_lines(now, [colours(*one) for one in named], most=most))
            self._chunks[chunk] = (now, key)

    def show_chosen(self, lines: Sequence[Line], voxels_mm: Array, voxel_mm: float) -> None:
        """Mark the chosen roots and voxels."""
        self.drop("/chosen/roots")
        self.drop("/chosen/voxels")
        if lines:
            wider = [replace(line, diameters_mm=1.25 * line.diameters_mm + 0.05) for line in lines]
            shades = [np.tile(np.array(_CHOSEN_RGB, np.uint8), (len(line.points_mm), 1)) for line in lines]
            self._add_triangles("/chosen/roots", tubes.of_lines(wider, shades))
        if len(voxels_mm):
            self._keep("/chosen/voxels", self._points("/chosen/voxels", voxels_mm, np.array(_CHOSEN_RGB, np.uint8), 1.1 * voxel_mm))

    def show_voxels(self, centre_mm: Array, share: Array, voxel_mm: float) -> None:
        """Draw voxels as squares, the fuller the darker."""
        self.drop("/voxels")
        if len(centre_mm):
            colours = np.asarray(255 - np.clip(share, 0.15, 1.0)[:, None] * (255 - _VOXEL_RGB), np.uint8)
            self._keep("/voxels", self._points("/voxels", centre_mm, colours, voxel_mm))

    def show_surface(self, mesh: Mesh | None, *, name: str = "/surface", colours: Bytes | None = None, aside_mm: float = 0.0) -> None:
        """Draw a surface, coarser where it has too many triangles; None takes it away."""
        self.drop(name)
        if mesh is None:
            return
        vertices, faces = mesh.vertices_mm + np.array([0.0, aside_mm, 0.0]), mesh.faces
        if colours is not None:
            self._add_triangles(name, Triangles(vertices, _normals(vertices, faces), faces, colours))
        else:
            colour, opacity = (_TRUTH_RGB, 0.55) if name == "/truth" else (_SURFACE_RGB, None)
            self._add_mesh(name, vertices, faces, colour, opacity=opacity)

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
        self._add_triangles(CANISTER, joined(parts), see_through=True)

    def show_cameras(self, pictures: Pictures, clicked: Callable[[int, viser.ClientHandle], None]) -> None:
        """Draw the cameras with their pictures; a click stands in one."""
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
        """Draw the points that are measured between, and the line."""
        self.drop("/measure/points")
        self.drop("/measure/line")
        if points_mm:
            self._keep("/measure/points", self._points("/measure/points", np.array(points_mm), np.array([220, 30, 30], np.uint8), 0.8))
        if len(points_mm) == 2:
            line = self._server.scene.add_line_segments("/measure/line", np.array([points_mm]), (220, 30, 30), thickness=0.25)
            self._keep("/measure/line", line)

    def set_visible(self, prefix: str, *, visible: bool) -> None:
        """Show or hide all that has a name with a prefix."""
        for name, handle in self._handles.items():
            if name.startswith(prefix) and handle.visible != visible:
                handle.visible = visible

    def __contains__(self, name: str) -> bool:
        return name in self._handles

    def clear(self) -> None:
        """Take everything away."""
        for name in list(self._handles):
            self.drop(name)
        self._chunks.clear()

    def _add_mesh(
        self, name: str, vertices: Array, faces: NDArray[np.int64], colour: tuple[int, int, int], *, opacity: float | None
    ) -> None:
        handle = self._server.scene.add_mesh_simple(
            name, vertices, faces, color=colour, opacity=opacity, side="double", cast_shadow=False, receive_shadow=False
        )
        self._keep(name, handle)

    def _add_triangles(self, name: str, triangles: Triangles, *, see_through: bool = False) -> None:
        data = glb(triangles, see_through=see_through)
        self._keep(name, self._server.scene.add_glb(name, data, cast_shadow=False, receive_shadow=False))

    def _points(self, name: str, points_mm: Array, colours: Bytes, size_mm: float) -> viser.SceneNodeHandle:
        return self._server.scene.add_point_cloud(
            name, points_mm.astype(np.float32), colours, point_size=size_mm, point_shape="square", precision="float32", point_shading="flat"
        )

    def _keep(self, name: str, handle: viser.SceneNodeHandle) -> None:
        self._handles[name] = handle

    def drop(self, name: str) -> None:
        """Take something away."""
        handle = self._handles.pop(name, None)
        if handle is not None:
            handle.remove()


def field_of_view(view: View) -> float:
    """Return a picture's vertical field of view (radians)."""
    return 2.0 * float(np.arctan(view.camera.image_wh[1] / 2.0 / view.camera.focal_px[1]))


def quaternion(rotation: Array) -> Array:
    """Return a rotation matrix as w, x, y, z."""
    return np.asarray(viser.transforms.SO3.from_matrix(rotation).wxyz)


def _normals(vertices: Array, faces: NDArray[np.int64]) -> Array:
    normals = shading.vertex_normals(Mesh(vertices_mm=vertices, faces=faces))
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12))


def _wall(
    radius: float,
    low: float,
    high: float,
    colour: tuple[int, int, int, int],
    begin: float = 0.0,
    end: float = 2.0 * np.pi,
    steps: int = 72,
) -> Triangles:
    """Return a part of a cylinder's wall about z, seen from inside: the half before the roots is left out."""
    angle = np.linspace(begin, end, steps + 1)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    vertices = np.concatenate([np.column_stack([radius * ring, np.full(len(ring), z)]) for z in (low, high)])
    inward = np.tile(np.column_stack([-ring, np.zeros(len(ring))]), (2, 1))
    a, up = np.arange(steps), steps + 1
    faces = np.concatenate([np.stack([a + 1, a, a + 1 + up], axis=1), np.stack([a + 1 + up, a, a + up], axis=1)])
    return Triangles(vertices, inward, faces, np.tile(np.array(colour, np.uint8), (len(vertices), 1)))


def _disc(radius: float, z: float, colour: tuple[int, int, int, int], steps: int = 72) -> Triangles:
    """Return a disc that is seen from above."""
    angle = np.linspace(0.0, 2.0 * np.pi, steps, endpoint=False)
    vertices = np.concatenate([[[0.0, 0.0, z]], np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(steps, z)], axis=1)])
    a = np.arange(steps)
    faces = np.stack([np.zeros(steps, np.int64), a + 1, (a + 1) % steps + 1], axis=1)
    count = len(vertices)
    return Triangles(vertices, np.tile([0.0, 0.0, 1.0], (count, 1)), faces, np.tile(np.array(colour, np.uint8), (count, 1)))

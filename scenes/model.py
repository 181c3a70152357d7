"""Data model of the rig: typed, frozen descriptions, whose defaults are those of the thesis (section 3.2).

The unit of a field is part of its name. Inclusive limits are stored as ``limits`` in the metadata of a field, and
enforced by `scenes.schema`.
"""

import textwrap
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

from rhizotwin.scenes.bands import Band
from rhizotwin.scenes.disturbances import Disturbances
from rhizotwin.scenes.limits import bounded
from rhizotwin.scenes.plants import Plant
from rhizotwin.scenes.shoots import Shoot
from rhizotwin.scenes.solution import Solution
from rhizotwin.scenes.specimens import Specimen
from rhizotwin.scenes.subject import Subject

if TYPE_CHECKING:
    from rhizotwin.scenes.frames import Array

_REPR_WIDTH = 120
"""Maximum width of the line of a part of a scene in its text, in characters."""


@dataclass(frozen=True, kw_only=True)
class Canister:
    """Round acrylic canister, 6 in wide and tall as in the thesis. Its rim is in the plane z = 0.

    With ``half_width_mm`` it is a rectangular vessel, which can be simulated but not reconstructed.
    """

    outer_radius_mm: float = bounded(76.2, 5.0, 500.0)
    """Outer radius of the canister, to be measured with callipers. This radius and the refractive indices determine how
    much the water magnifies."""
    wall_mm: float = bounded(3.175, 0.2, 50.0)
    """Thickness of the wall of the canister."""
    height_mm: float = bounded(152.4, 10.0, 2000.0)
    """Height of the canister, from the underside of its base to the rim."""
    base_mm: float = bounded(6.0, 0.5, 100.0)
    """Thickness of the base of the canister. The upper side of the base is the floor of the water, and is assumed to be
    opaque and matt."""
    n_wall: float = bounded(1.49, 1.0, 2.0)
    """Refractive index of the canister's wall: 1.49 for acrylic, 1.52 for glass, 1.58 for polycarbonate."""
    half_width_mm: float | None = field(default=None, metadata={"limits": (5.0, 500.0)})
    """Half the outer width (y) of a rectangular vessel with plane walls, whose half depth (x) is ``outer_radius_mm``.
    It is None for a round canister, the only one that can be reconstructed."""

    @property
    def inner_radius_mm(self) -> float:
        """Inner radius of the canister, and thus radius of the water column, mm."""
        return self.outer_radius_mm - self.wall_mm

    @property
    def floor_z_mm(self) -> float:
        """Height (z) of the bottom of the water in the canister frame, mm."""
        return self.base_mm - self.height_mm


@dataclass(frozen=True, kw_only=True)
class Water:
    """Nutrient solution in the canister."""

    level_mm: float = bounded(-4.0, -2000.0, 0.0)
    """Height (z) of the water surface, which must be above the net pot's grid."""
    n_water: float = bounded(1.333, 1.0, 2.0)
    """Refractive index of the water, 1.333 for pure water. An error of 0.001 displaces a root by 0.03 mm at a depth of
    40 mm."""
    absorption_per_mm: float = bounded(0.0, 0.0, 0.1)
    """Absorption coefficient of the water. It is negligible in visible light, and 0.004 per mm at 850 nm."""


@dataclass(frozen=True, kw_only=True)
class NetPot:
    """Net pot on the canister's rim, with an opaque skirt around the canister to which the marker strip is attached."""

    outer_radius_mm: float = bounded(79.6, 5.0, 600.0)
    """Radius of the marker strip on the net pot. It determines the scale of the reconstruction, and must therefore be
    measured with the strip attached."""
    skirt_bottom_mm: float = bounded(-6.0, -1000.0, 500.0)
    """Height (z) of the lower edge of the skirt. Above this height, the skirt hides the canister."""
    top_mm: float = bounded(31.0, -1000.0, 500.0)
    """Height (z) of the net pot's upper edge."""
    grid_z_mm: float = bounded(-8.0, -1000.0, 0.0)
    """Height (z) of the underside of the opaque grid and the felt inside the canister. Roots are visible only below
    this height."""


@dataclass(frozen=True, kw_only=True)
class MarkerStrip:
    """Strip of ArUco markers around the net pot, with rows from the top and columns counter-clockwise seen from above.

    Column k is centred at azimuth (k + 0.5) * 2 pi / columns from the seam (+x). The marker in row j and column k has
    the id ``first_id + j * columns + k`` if the dictionary has enough markers. Otherwise the strip is coded: the ids of
    its markers are those of `scenes.markers.marker_ids`.
    """

    dictionary: str = "APRILTAG_36h11"
    """ArUco dictionary of the markers, as named in OpenCV."""
    columns: int = bounded(31, 4, 500)
    """Number of markers in a row, evenly spaced around the net pot."""
    rows: int = bounded(2, 0, 10)
    """Number of rows of markers. If it is 0, there is no strip, and the cameras are determined from the edges of the
    canister and the roots."""
    marker_mm: float = bounded(13.0, 1.0, 200.0)
    """Side length of the black square of a marker, to be measured on the print. An error of 1 % changes every
    reconstructed length by 1 %."""
    row_pitch_mm: float = bounded(16.5, 1.0, 300.0)
    """Distance between the lower edges of adjacent rows."""
    bottom_mm: float = bounded(-3.0, -1000.0, 500.0)
    """Height (z) of the lower edge of the markers in the lowest row."""
    first_id: int = bounded(0, 0, 1_000_000)
    """Id of the first marker; of a coded strip, the number of its canister, counted from 0, times the number of markers
    on the strip. Strips with different ids identify different plants."""


@dataclass(frozen=True, kw_only=True)
class Surroundings:
    """Medium between the camera and the canister."""

    n: float = bounded(1.0, 1.0, 2.0)
    """Refractive index of the medium, which is 1 for air. A larger index is that of a liquid in a tank around the
    canister. It reduces refraction at the wall most if it is close to that of the water. A larger index requires a
    telecentric camera perpendicular to the flat window of the tank, because only parallel rays pass such a window
    without refraction."""


@dataclass(frozen=True, kw_only=True)
class Tank:
    """Rectangular tank in which the canister rotates (T5.3).

    The tank is filled with liquid to its rim. It is static in the rig, with one wall towards the camera. The camera
    views the roots through this wall, and the marker strip through the air above it.
    """

    front_mm: float = bounded(100.0, 10.0, 2000.0)
    """Position (x) of the outside of the front wall. The outside of the back wall is at -front_mm."""
    half_width_mm: float = bounded(130.0, 10.0, 2000.0)
    """Position (y) of the outside of the side walls, which are at +half_width_mm and -half_width_mm."""
    wall_mm: float = bounded(5.0, 0.2, 50.0)
    """Thickness of the tank's walls."""
    n_wall: float = bounded(1.49, 1.0, 2.0)
    """Refractive index of the tank's walls."""
    n_liquid: float = bounded(1.333, 1.0, 2.0)
    """Refractive index of the liquid. Water is a suitable liquid. An index equal to that of the canister's water
    minimises refraction."""
    level_mm: float = bounded(-8.0, -2000.0, 0.0)
    """Height (z) of the liquid's surface and of the tank's rim, below the marker strip."""
    turn_deg: float = bounded(0.0, -10.0, 10.0)
    """Rotation of the tank relative to the axes of the rig, counter-clockwise seen from above. It is measured in the
    pictures if the canister's edges are visible."""


FAR_MM = 1.5e5
"""Distance of the pinhole camera that approximates a telecentric camera, mm. An object that is 50 mm nearer than the
axis is magnified by an additional 1/3000, which is a displacement of 0.08 px at 250 px from the axis. At much larger
distances, single precision cannot resolve heights to 1e-4 mm for a camera that is tilted by a degree."""


@dataclass(frozen=True, kw_only=True)
class Camera:
    """Camera with the OpenCV distortion model. Pixel centres have integer coordinates."""

    kind: Literal["pinhole", "telecentric"] = "pinhole"
    """Projection of the camera. ``telecentric``: the rays are parallel, adjacent pixels are ``mm_per_px`` apart at the
    specimen, and ``focal_px`` and ``distortion`` are not used."""
    mm_per_px: float = bounded(0.1, 1e-5, 100.0)
    """Size of a pixel at the specimen. It is only used for a telecentric camera."""
    image_wh: tuple[int, int] = bounded((800, 600), 16, 20000)
    """Width and height of the pictures. Roots should be at least three pixels wide."""
    focal_px: tuple[float, float] = bounded((1300.0, 1300.0), 1.0, 1e6)
    """Focal lengths in x and y, as measured by `rhizotwin calibrate camera`."""
    principal_px: tuple[float, float] = bounded((399.5, 299.5), -1e6, 1e6)
    """Principal point, at which the optical axis intersects the picture. Pixel centres have integer coordinates."""
    distortion: tuple[float, float, float, float, float] = bounded((0.0, 0.0, 0.0, 0.0, 0.0), -10.0, 10.0)
    """Distortion coefficients k1, k2, p1, p2, k3 of the OpenCV model."""
    bits: int = bounded(12, 8, 16)
    """Bit depth of the analogue-to-digital converter. Pictures with more than 8 bits are stored left-aligned in 16-bit
    PNG files."""
    transfer: Literal["linear", "srgb", "table"] = "linear"
    """Transfer curve from light to pixel values: linear, sRGB, or ``transfer_table``. It is used if the picture file
    does not state a curve."""
    transfer_table: tuple[float, ...] = bounded((), 0.0, 1.0)
    """Transfer curve as a table: light, as a fraction of full scale, at equally spaced pixel values from 0 to full
    scale. It is determined by `rhizotwin calibrate transfer`."""
    bands: tuple[Band, ...] = ()
    """Bands in which every view is taken, in order of capture. If there are none, each view is one picture that
    is not limited to a band."""

    def resized(self, image_wh: tuple[int, int]) -> "Camera":
        """Return the camera with a picture size of ``image_wh`` and an unchanged horizontal field of view."""
        scale = image_wh[0] / self.image_wh[0]
        cx, cy = self.principal_px
        margin_y = (image_wh[1] - scale * self.image_wh[1]) / 2.0
        return replace(
            self,
            image_wh=image_wh,
            mm_per_px=self.mm_per_px / scale,
            focal_px=(self.focal_px[0] * scale, self.focal_px[1] * scale),
            principal_px=((cx + 0.5) * scale - 0.5, (cy + 0.5) * scale - 0.5 + margin_y),
        )

    def cropped(self, low_px: tuple[int, int], size_px: tuple[int, int]) -> "Camera":
        """Return the camera of pictures of which only some pixels are kept.

        Parameters
        ----------
        low_px : tuple of int
            First column and first row that are kept.
        size_px : tuple of int
            Number of columns and rows that are kept.
        """
        (cx, cy), (left, top) = self.principal_px, low_px
        return replace(self, image_wh=size_px, principal_px=(cx - left, cy - top))

    def as_pinhole(self, depth_mm: float = FAR_MM) -> "Camera":
        """Return the camera itself, or the pinhole camera that shows objects at a depth as large as a telecentric one.

        By default, the depth is so large that the pinhole camera approximates the telecentric camera.
        """
        if self.kind == "pinhole":
            return self
        focal = depth_mm / self.mm_per_px
        return replace(self, kind="pinhole", focal_px=(focal, focal), distortion=(0.0, 0.0, 0.0, 0.0, 0.0))

    def pinhole_pose(self, cam_from_canister: "Array") -> "Array":
        """Return the pose (4, 4) of the camera that `as_pinhole` returns by default.

        A telecentric camera is moved back along its optical axis, which does not change the picture.
        """
        if self.kind == "pinhole":
            return cam_from_canister
        pose = cam_from_canister.copy()
        pose[2, 3] = FAR_MM
        return pose

    def focused(self, scale: float) -> "Camera":
        """Return the camera after focusing. The focal lengths are multiplied by ``scale``."""
        return replace(self, focal_px=(self.focal_px[0] * scale, self.focal_px[1] * scale), mm_per_px=self.mm_per_px / scale)


@dataclass(frozen=True, kw_only=True)
class Lights:
    """Diffuse backlight panel, and a front light above the camera, both in the rig frame.

    The panel is in the plane x = -backlight_distance_mm.
    """

    backlight_distance_mm: float = bounded(160.0, 10.0, 5000.0)
    """Distance between the table's axis and the panel behind the canister."""
    backlight_wh_mm: tuple[float, float] = bounded((700.0, 500.0), 1.0, 10000.0)
    """Width and height of the illuminated panel. It must fill the picture behind the canister. Otherwise, its edge
    would be detected as a root."""
    backlight_z_mm: float = bounded(-60.0, -5000.0, 5000.0)
    """Height (z) of the panel's centre."""
    backlight_level: float = bounded(0.75, 0.0, 1.0)
    """Brightness of the bare panel, as a fraction of the camera's full scale."""
    front_xz_mm: tuple[float, float] = bounded((260.0, 260.0), -5000.0, 5000.0)
    """Position (x and z) of the front light. It should be above the camera, so that the canister does not reflect
    it."""
    front_wh_mm: tuple[float, float] = bounded((300.0, 60.0), 1.0, 10000.0)
    """Width and height of the front light."""
    front_level: float = bounded(0.5, 0.0, 1.0)
    """Brightness of white paper on the strip that faces the camera, as a fraction of full scale."""
    side_level: float = bounded(0.0, 0.0, 1.0)
    """Brightness of a white surface in the water that faces a light at the left or the right of the canister, as a
    fraction of full scale. With ``backlight_level`` 0, roots are bright on dark ground (dark field). Such pictures can
    be simulated but not reconstructed."""


@dataclass(frozen=True, kw_only=True)
class Turntable:
    """Turntable that rotates the canister."""

    direction: Literal[1, -1] = 1
    """Sense of rotation of the table. If it is +1, positive angles rotate the canister counter-clockwise seen from
    above, and if it is -1, clockwise."""


@dataclass(frozen=True, kw_only=True)
class Ring:
    """Full or partial revolution of the table, during which the camera does not move."""

    views: int = bounded(40, 1, 10000)
    """Number of views in the ring. Views from opposite sides show nearly the same outline. An odd number of views,
    which has no opposite views, therefore provides about as much information as twice as many views."""
    height_mm: float = bounded(-42.0, -2000.0, 2000.0)
    """Height (z) of the camera in the rig frame."""
    distance_mm: float = bounded(400.0, 20.0, 10000.0)
    """Horizontal distance between the camera and the table's axis."""
    tilt_deg: float = bounded(0.0, -89.0, 89.0)
    """Angle of the optical axis below the horizon."""
    first_deg: float = bounded(0.0, -360.0, 360.0)
    """Table angle of the first view. All views are spaced evenly over `span_deg`."""
    span_deg: float = bounded(360.0, 1.0, 360.0)
    """Angle by which the table rotates during the ring. A ring with a partial revolution can add closely spaced views
    to a ring with a full revolution."""
    jitter_mm: float = bounded(0.0, 0.0, 50.0)
    """Standard deviation of a random change of the camera's position, for each view and axis. The change is part of the
    commanded position."""
    jitter_deg: float = bounded(0.0, 0.0, 20.0)
    """Standard deviation of a random change of the camera's orientation, for each view and axis. The change is part of
    the commanded orientation."""
    kind: Literal["root", "shoot"] = "root"
    """Subject of the ring: the roots in the water, or the shoot in air."""
    bands: tuple[str, ...] = ()
    """Names of the camera's bands in which the views are taken. If there are none, all bands are used."""


@dataclass(frozen=True, kw_only=True)
class CapturePlan:
    """Rings of a scan, in order of capture."""

    rings: tuple[Ring, ...] = (Ring(),)
    """Rings of the scan. A second ring at a different height resolves horizontal roots that one height cannot
    resolve."""


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Complete rig with a specimen and a capture plan."""

    name: str = "scene"
    """Name shown in lists and reports. The default is the name of the file."""
    description: str = ""
    """One-line description for lists and reports."""
    subject: Subject = Subject()
    solution: Solution = field(default_factory=Solution)
    canister: Canister = Canister()
    water: Water = Water()
    net_pot: NetPot = NetPot()
    strip: MarkerStrip = MarkerStrip()
    surroundings: Surroundings = Surroundings()
    tank: Tank | None = None
    """Tank around the canister. It is None if the canister is in air."""
    camera: Camera = Camera()
    lights: Lights = Lights()
    turntable: Turntable = Turntable()
    plan: CapturePlan = CapturePlan()
    specimen: Specimen | None = None
    """Specimen in the canister. It is None if it is unknown, as on a real rig and in every dataset."""
    plants: tuple[Plant, ...] = ()
    """Plants in a canister with several plants. There are none if the canister contains a single plant, which is
    described by ``specimen``."""
    shoot: Shoot | None = None
    """Shoot above the net pot. It is None if there is no shoot, or if the shoot is unknown."""
    disturbances: Disturbances = field(default_factory=Disturbances)

    def __repr__(self) -> str:
        """Return name, description, and one line for each part that differs from the default scene."""
        default = Scene()
        lines = [f"Scene {self.name!r}: {self.description}".removesuffix(": ")]
        for part in fields(self)[2:]:
            value, usual = getattr(self, part.name), getattr(default, part.name)
            if value != usual:
                changed = _changed_fields(value, usual) if is_dataclass(value) and is_dataclass(usual) else repr(value)
                lines.append(textwrap.shorten(f"{part.name}: {changed}", _REPR_WIDTH, placeholder=" ..."))
        return "\n  ".join(lines)

    def lights_in(self, band: str) -> Lights:
        """Return the lights in a band of the camera. If the name is empty, the lights of the scene are returned."""
        lights = self.lights
        for one in self.camera.bands:
            if one.name == band:
                panel = lights.backlight_level if one.panel_level is None else one.panel_level
                front = lights.front_level if one.front_level is None else one.front_level
                return replace(lights, backlight_level=panel, front_level=front)
        return lights

    def is_lit(self, band: str) -> bool:
        """Return whether the panel and the front light are both on in a band.

        Outlines and markers are visible only in such a band.
        """
        lights = self.lights_in(band)
        return lights.backlight_level > 0.0 and lights.front_level > 0.0

    @property
    def is_planted(self) -> bool:
        """Whether it is known what is in the canister."""
        return self.specimen is not None or any(plant.specimen is not None for plant in self.plants)


def _changed_fields(value: Any, usual: Any) -> str:
    """Return the fields of a part of a scene that differ from those of another one."""
    pairs = [(part.name, getattr(value, part.name), getattr(usual, part.name)) for part in fields(value)]
    return ", ".join(f"{name} = {one!r}" for name, one, other in pairs if one != other)

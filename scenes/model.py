"""What stands on the rig: typed, frozen descriptions. The defaults are the rig of the thesis (section 3.2).

A field's unit is in its name. ``limits`` in a field's metadata are inclusive bounds that `scenes.schema` enforces.
"""

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

from rhizotwin.scenes.bands import Band
from rhizotwin.scenes.limits import bounded
from rhizotwin.scenes.plants import Plant
from rhizotwin.scenes.shoots import Shoot
from rhizotwin.scenes.solution import Solution
from rhizotwin.scenes.specimens import Specimen
from rhizotwin.scenes.subject import Subject

if TYPE_CHECKING:
    from rhizotwin.scenes.frames import Array


@dataclass(frozen=True, kw_only=True)
class Canister:
    """Round acrylic canister, 6 in wide and tall as in the thesis; its rim lies in the plane z = 0."""

    outer_radius_mm: float = bounded(76.2, 5.0, 500.0)
    """Outside of the wall; with the indices it decides how much the water magnifies, so measure it with calipers."""
    wall_mm: float = bounded(3.175, 0.2, 50.0)
    """Thickness of the wall."""
    height_mm: float = bounded(152.4, 10.0, 2000.0)
    """Rim to the underside of the base."""
    base_mm: float = bounded(6.0, 0.5, 100.0)
    """Thickness of the base; its inner face, opaque and matt, is the water's floor."""
    n_wall: float = bounded(1.49, 1.0, 2.0)
    """Refractive index of the wall: acrylic 1.49, glass 1.52, polycarbonate 1.58."""

    @property
    def inner_radius_mm(self) -> float:
        """Radius of the water column."""
        return self.outer_radius_mm - self.wall_mm

    @property
    def floor_z_mm(self) -> float:
        """Height of the water's floor in the canister frame."""
        return self.base_mm - self.height_mm


@dataclass(frozen=True, kw_only=True)
class Water:
    """Nutrient solution in the canister."""

    level_mm: float = bounded(-4.0, -2000.0, 0.0)
    """z of the surface; above the net pot's grid."""
    n_water: float = bounded(1.333, 1.0, 2.0)
    """Refractive index of what the roots stand in: water 1.333; an error of 0.001 moves a root by 0.03 mm at 40 mm."""
    absorption_per_mm: float = bounded(0.0, 0.0, 0.1)
    """Light that the water absorbs; next to nothing in the visible, 0.004 per mm at 850 nm."""


@dataclass(frozen=True, kw_only=True)
class NetPot:
    """Net pot over the rim; an opaque skirt outside the canister carries the marker strip."""

    outer_radius_mm: float = bounded(79.6, 5.0, 600.0)
    """Radius on which the marker strip lies; it gives every picture its scale, so measure it with the strip on."""
    skirt_bottom_mm: float = bounded(-6.0, -1000.0, 500.0)
    """z of the skirt's lower edge; the canister is hidden above it."""
    top_mm: float = bounded(31.0, -1000.0, 500.0)
    """z of the net pot's upper edge."""
    grid_z_mm: float = bounded(-8.0, -1000.0, 0.0)
    """Underside of the opaque grid and felt inside the canister: roots are seen below it."""


@dataclass(frozen=True, kw_only=True)
class MarkerStrip:
    """Strip of ArUco markers round the net pot, rows from the top, columns counter-clockwise seen from above.

    Column k is centred at azimuth (k + 0.5) * 2 pi / columns from the seam (+x); the marker in row j, column k has the
    id ``first_id + j * columns + k``. From outside, ids rise to the right.
    """

    dictionary: str = "APRILTAG_36h11"
    """Dictionary of the markers as OpenCV names it."""
    columns: int = bounded(31, 4, 500)
    """Markers in a row, evenly round the net pot."""
    rows: int = bounded(2, 0, 10)
    """0: there is no strip; cameras are found from the canister's edges and the roots."""
    marker_mm: float = bounded(13.0, 1.0, 200.0)
    """Edge of a marker's black square, measured on the print: a printer that scales by 1 % makes every length 1 %
    wrong."""
    row_pitch_mm: float = bounded(16.5, 1.0, 300.0)
    """From a row's lower edge to that of the row above it."""
    bottom_mm: float = bounded(-3.0, -1000.0, 500.0)
    """z of the lower edge of the lowest row's markers."""
    first_id: int = bounded(0, 0, 10000)
    """Number of the first marker in its dictionary: strips with other numbers tell plants apart."""


@dataclass(frozen=True, kw_only=True)
class Surroundings:
    """What stands between the camera and the canister."""

    n: float = bounded(1.0, 1.0, 2.0)
    """Index: 1 is air. The liquid of a tank about the canister (near the water's index, so that the wall bends little)
    for a telecentric camera that looks squarely through the tank's flat window: parallel rays pass such a window
    unbent."""


@dataclass(frozen=True, kw_only=True)
class Tank:
    """Rectangular tank of liquid in which the canister turns (T5.3), filled to its rim.

    It stands still in the rig, one wall towards the camera, which sees the roots through it and the marker strip in air
    above it.
    """

    front_mm: float = bounded(100.0, 10.0, 2000.0)
    """Outside of the front wall at x = front_mm, of the back wall at x = -front_mm."""
    half_width_mm: float = bounded(130.0, 10.0, 2000.0)
    """Outside of the side walls at y = +-half_width_mm."""
    wall_mm: float = bounded(5.0, 0.2, 50.0)
    """Thickness of its walls."""
    n_wall: float = bounded(1.49, 1.0, 2.0)
    """Index of its walls."""
    n_liquid: float = bounded(1.333, 1.0, 2.0)
    """Water does; what has the water's own index hides the canister's wall most."""
    level_mm: float = bounded(-8.0, -2000.0, 0.0)
    """z of its surface, below the marker strip; so high are its walls."""
    turn_deg: float = bounded(0.0, -10.0, 10.0)
    """How it is turned from square to the rig, counter-clockwise from above; the canister's edges tell it better than
    an eye does, where they are seen."""


FAR_MM = 1.5e5
"""Distance of the pinhole that stands for a telecentric camera.

What is 50 mm nearer than the axis is seen 1/3000 larger through it, by 0.08 px at 250 px from the axis. Much farther,
single precision no longer tells heights to 1e-4 mm for a camera that is tilted by a degree.
"""


@dataclass(frozen=True, kw_only=True)
class Camera:
    """Camera with OpenCV distortion; pixel centres are at integers."""

    kind: Literal["pinhole", "telecentric"] = "pinhole"
    """``telecentric``: parallel rays, ``mm_per_px`` apart; ``focal_px`` and ``distortion`` are not used."""
    mm_per_px: float = bounded(0.1, 1e-5, 100.0)
    """Size of a pixel on the specimen; only for a telecentric camera."""
    image_wh: tuple[int, int] = bounded((800, 600), 16, 20000)
    """Width and height of the pictures in pixels; a root should be three pixels wide or more."""
    focal_px: tuple[float, float] = bounded((1300.0, 1300.0), 1.0, 1e6)
    """Focal lengths in x and y, in pixels, as `rhizotwin calibrate camera` measures them."""
    principal_px: tuple[float, float] = bounded((399.5, 299.5), -1e6, 1e6)
    """Where the optical axis meets the picture; pixel centres are at whole numbers."""
    distortion: tuple[float, float, float, float, float] = bounded((0.0, 0.0, 0.0, 0.0, 0.0), -10.0, 10.0)
    """k1, k2, p1, p2, k3 of the OpenCV model."""
    bits: int = bounded(12, 8, 16)
    """Depth of the converter; pictures of more than 8 bits are stored left-aligned in 16-bit PNG."""
    transfer: Literal["linear", "srgb", "table"] = "linear"
    """How light becomes a picture's numbers where the file does not say it: in proportion, by sRGB's curve, or by
    ``transfer_table``."""
    transfer_table: tuple[float, ...] = bounded((), 0.0, 1.0)
    """Light, of full scale, at equal steps of the number from 0 to full scale (`rhizotwin calibrate transfer` writes
    it)."""
    bands: tuple[Band, ...] = ()
    """Bands in which every view is taken, in this order; none: one picture a view, of all light."""

    def resized(self, image_wh: tuple[int, int]) -> "Camera":
        """Return the same lens on a sensor with ``image_wh`` pixels over the same field of view (horizontally)."""
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

    def as_pinhole(self) -> "Camera":
        """Return the camera itself; for a telecentric one the pinhole at `FAR_MM` that sees the same."""
        if self.kind == "pinhole":
            return self
        focal = FAR_MM / self.mm_per_px
        return replace(self, kind="pinhole", focal_px=(focal, focal), distortion=(0.0, 0.0, 0.0, 0.0, 0.0))

    def pinhole_pose(self, cam_from_canister: "Array") -> "Array":
        """Return the pose (4, 4) of `as_pinhole`.

        For a telecentric camera moved back along its axis, which nobody can see.
        """
        if self.kind == "pinhole":
            return cam_from_canister
        pose = cam_from_canister.copy()
        pose[2, 3] = FAR_MM
        return pose

    def focused(self, scale: float) -> "Camera":
        """Return the same camera with focal lengths ``scale`` times as long (lenses breathe when they are focused)."""
        return replace(self, focal_px=(self.focal_px[0] * scale, self.focal_px[1] * scale), mm_per_px=self.mm_per_px / scale)


@dataclass(frozen=True, kw_only=True)
class Lights:
    """A diffused backlight panel and a strip light above the front, both in the rig frame.

    The panel stands at x = -backlight_distance_mm.
    """

    backlight_distance_mm: float = bounded(160.0, 10.0, 5000.0)
    """From the table's axis to the panel behind the canister."""
    backlight_wh_mm: tuple[float, float] = bounded((700.0, 500.0), 1.0, 10000.0)
    """Width and height of the lit panel: it must fill the picture behind the canister, or its edge is taken for a
    root."""
    backlight_z_mm: float = bounded(-60.0, -5000.0, 5000.0)
    """z of the panel's middle."""
    backlight_level: float = bounded(0.75, 0.0, 1.0)
    """Fraction of the camera's full scale that the bare panel reaches."""
    front_xz_mm: tuple[float, float] = bounded((260.0, 260.0), -5000.0, 5000.0)
    """Where the front light stands, x and z: above the camera, so that the canister does not mirror it."""
    front_wh_mm: tuple[float, float] = bounded((300.0, 60.0), 1.0, 10000.0)
    """Width and height of the front light."""
    front_level: float = bounded(0.5, 0.0, 1.0)
    """Fraction of full scale that white paper on the strip reaches, facing the camera."""


@dataclass(frozen=True, kw_only=True)
class Turntable:
    """Turntable under the canister."""

    direction: Literal[1, -1] = 1
    """+1: positive angles turn the canister counter-clockwise seen from above."""


@dataclass(frozen=True, kw_only=True)
class Ring:
    """One turn of the table, or a part of one, before a camera at rest."""

    views: int = bounded(40, 1, 10000)
    """Pictures in the turn; an odd number tells about as much as twice as many, since opposite pictures see nearly the
    same outline."""
    height_mm: float = bounded(-42.0, -2000.0, 2000.0)
    """z of the camera in the rig frame."""
    distance_mm: float = bounded(400.0, 20.0, 10000.0)
    """Camera to the table's axis, horizontally."""
    tilt_deg: float = bounded(0.0, -89.0, 89.0)
    """Optical axis below the horizon."""
    first_deg: float = bounded(0.0, -360.0, 360.0)
    """Table angle of the first view; the others follow evenly over `span_deg`."""
    span_deg: float = bounded(360.0, 1.0, 360.0)
    """How far the table turns: a part of a turn is a patch of close pictures beside a ring that goes round."""
    jitter_mm: float = bounded(0.0, 0.0, 50.0)
    """Standard deviation of a commanded per-view change of the camera's position, each axis."""
    jitter_deg: float = bounded(0.0, 0.0, 20.0)
    """Standard deviation of a commanded per-view change of the camera's orientation, each axis."""
    kind: Literal["root", "shoot"] = "root"
    """What the ring looks at: the roots through the water, or the shoot in the air."""
    bands: tuple[str, ...] = ()
    """Names of the camera's bands in which its views are taken; none: in all of them."""


@dataclass(frozen=True, kw_only=True)
class CapturePlan:
    """The rings of a scan, in order."""

    rings: tuple[Ring, ...] = (Ring(),)
    """One turn of the table each; a second height cures what one height cannot see of level roots."""


@dataclass(frozen=True, kw_only=True)
class Disturbances:
    """What a real rig gets wrong. Every zero (or None) means perfect; profiles are files of these with reasons."""

    full_well_e: float | None = field(default=None, metadata={"limits": (100.0, 1e6)})
    """Electrons at full scale: photon noise is Poisson in these. None: no photon noise."""
    read_noise_e: float = bounded(0.0, 0.0, 1000.0)
    """Standard deviation of the noise of reading a pixel, in electrons."""
    aperture_mm: float = bounded(0.0, 0.0, 50.0)
    """Diameter of the lens opening; 0 is a pinhole, otherwise what is off the focus distance blurs."""
    focus_error_mm: float = bounded(0.0, -200.0, 200.0)
    """Focus distance minus the distance from camera to the table's axis."""
    focal_error: float = bounded(0.0, -0.05, 0.05)
    """True over given focal length, less 1: the lens was focused anew after it was calibrated; unknown to the
    reconstruction."""
    distortion: tuple[float, float, float, float, float] = bounded((0.0, 0.0, 0.0, 0.0, 0.0), -10.0, 10.0)
    """Lens distortion added to the camera's, known to the reconstruction (a calibrated lens)."""
    arm_deg: float = bounded(0.0, 0.0, 10.0)
    """Standard deviation of the camera's orientation about each axis, drawn once a ring, unknown to the
    reconstruction."""
    arm_mm: float = bounded(0.0, 0.0, 50.0)
    """Standard deviation of the camera's position on each axis, drawn once a ring, unknown to the reconstruction."""
    table_deg: float = bounded(0.0, 0.0, 10.0)
    """Standard deviation of the table angle, drawn for each view, unknown to the reconstruction."""
    canister_offset_mm: float = bounded(0.0, 0.0, 20.0)
    """How far the canister (with pot, strip and plant) stands from the table's axis, in a drawn direction."""
    canister_tilt_deg: float = bounded(0.0, 0.0, 10.0)
    """How far the canister leans, in a drawn direction."""
    strip_offset_mm: float = bounded(0.0, 0.0, 10.0)
    """How far the net pot with its strip sits off the canister's axis, in a drawn direction."""
    strip_tilt_deg: float = bounded(0.0, 0.0, 5.0)
    """How far the net pot with its strip leans against the canister's axis, in a drawn direction."""
    backlight_unevenness: float = bounded(0.0, 0.0, 0.9)
    """Peak-to-peak relative change of the backlight over the panel (smooth, drawn)."""
    n_water_error: float = bounded(0.0, -0.1, 0.1)
    """True minus nominal index of the water."""
    transfer: Literal["linear", "srgb"] = "linear"
    """The camera's curve from light to numbers, known to the reconstruction (a camera whose settings are known)."""
    stored_bits: int | None = field(default=None, metadata={"limits": (8, 16)})
    """Depth of the stored pictures; None: the camera's ``bits``."""
    jpeg_quality: int | None = field(default=None, metadata={"limits": (1, 100)})
    """Quality of the JPEG files that pictures are stored in; None: PNG."""
    exposure_wander: float = bounded(0.0, 0.0, 0.9)
    """Each picture's exposure is drawn evenly from 1 - this to 1 + this; unknown to the reconstruction."""
    white_balance_wander: float = bounded(0.0, 0.0, 0.9)
    """The same for the gains of red and blue, each by itself; above 0 the pictures are in colour."""
    vignetting: float = bounded(0.0, 0.0, 0.95)
    """Share of the light that the lens loses in the picture's corners, growing with the square of the distance from the
    middle."""
    root_mu_per_mm: float | None = field(default=None, metadata={"limits": (0.01, 1000.0)})
    """Attenuation of root tissue per mm of chord. None: opaque roots."""
    root_n: float | None = field(default=None, metadata={"limits": (1.0, 2.0)})
    """Index of root tissue, which refracts and attenuates by ``root_mu_per_mm``. None: roots only attenuate."""
    root_hair_mm: float = bounded(0.0, 0.0, 10.0)
    """Length of the root hairs that stand out from every root as a grey sleeve."""
    root_hair_mu_per_mm: float = bounded(0.0, 0.0, 100.0)
    """Attenuation in that sleeve."""
    sway_mm: float = bounded(0.0, 0.0, 20.0)
    """Standard deviation, each way, of where the lowest tip hangs in a view; what is higher moves the less, and the top
    not at all."""
    canister_radius_error_mm: float = bounded(0.0, -10.0, 10.0)
    """True minus nominal outer radius of the canister; unknown to the reconstruction, as the next three are."""
    canister_out_of_round_mm: float = bounded(0.0, 0.0, 10.0)
    """Half the difference between the canister's largest and smallest outer radius: it is an oval that turns with
    it."""
    wall_error: float = bounded(0.0, -0.5, 0.5)
    """True over nominal thickness of the canister's wall, less 1."""
    n_wall_error: float = bounded(0.0, -0.1, 0.1)
    """True minus nominal index of the wall."""
    seam_opacity: float = bounded(0.0, 0.0, 1.0)
    """Light that the seam of a rolled tube absorbs, 1 mm wide, in a drawn direction; it turns with the canister."""
    dust_specks: int = bounded(0, 0, 100000)
    """Number of opaque specks on the canister's outside."""
    scratches: int = bounded(0, 0, 10000)
    """Number of scratches on the canister's outside, which absorb half of the light."""
    highlight: float = bounded(0.0, 0.0, 1.0)
    """Light, of full scale, that a lamp's reflection in the wall adds, in a streak that stands still while the canister
    turns."""
    algae_patches: int = bounded(0, 0, 1000)
    """Number of algae films on the inner wall (they turn with the canister)."""
    algae_opacity: float = bounded(0.0, 0.0, 1.0)
    """Light that the middle of an algae film absorbs."""
    turbidity_per_mm: float = bounded(0.0, 0.0, 0.1)
    """Extinction of the water per mm."""
    felt_fibres: int = bounded(0, 0, 10000)
    """Number of black fibres that hang from the net pot into the water."""
    bubbles: int = bounded(0, 0, 10000)
    """Number of air bubbles in the water at the wall."""


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A whole rig with a specimen and a capture plan."""

    name: str = "scene"
    """Shown in lists and reports; default: the file's name."""
    description: str = ""
    """One line for lists and reports."""
    subject: Subject = Subject()
    solution: Solution = field(default_factory=Solution)
    canister: Canister = Canister()
    water: Water = Water()
    net_pot: NetPot = NetPot()
    strip: MarkerStrip = MarkerStrip()
    surroundings: Surroundings = Surroundings()
    tank: Tank | None = None
    """None: the canister stands in the open."""
    camera: Camera = Camera()
    lights: Lights = Lights()
    turntable: Turntable = Turntable()
    plan: CapturePlan = CapturePlan()
    specimen: Specimen | None = None
    """None: not known, as on a real rig and in every dataset."""
    plants: tuple[Plant, ...] = ()
    """Several plants in one canister; none: there is one, that of ``specimen``."""
    shoot: Shoot | None = None
    """What grows above the net pot; None: nothing, or not known."""
    disturbances: Disturbances = Disturbances()

    def lights_in(self, band: str) -> Lights:
        """Return the lights as they are in the camera's band of that name; for an empty name, as given."""
        lights = self.lights
        for one in self.camera.bands:
            if one.name == band:
                panel = lights.backlight_level if one.panel_level is None else one.panel_level
                front = lights.front_level if one.front_level is None else one.front_level
                return replace(lights, backlight_level=panel, front_level=front)
        return lights

    def is_lit(self, band: str) -> bool:
        """Tell whether panel and front light are both on in a band: only then pictures show outlines and markers."""
        lights = self.lights_in(band)
        return lights.backlight_level > 0.0 and lights.front_level > 0.0

    @property
    def is_planted(self) -> bool:
        """Tell whether it is known what stands in the canister."""
        return self.specimen is not None or any(plant.specimen is not None for plant in self.plants)

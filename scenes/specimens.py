"""What grows (or stands in) the canister: one frozen description a kind of specimen."""

from dataclasses import dataclass, field
from typing import Literal

from rhizotwin.scenes.limits import bounded


@dataclass(frozen=True, kw_only=True)
class SphereSpecimen:
    """A sphere, the simplest thing with a known volume."""

    diameter_mm: float = bounded(20.0, 0.1, 200.0)
    """Diameter of the sphere."""
    centre_mm: tuple[float, float, float] = bounded((0.0, 0.0, -55.0), -1000.0, 1000.0)
    """Its middle, canister frame: origin on the axis in the plane of the rim, z up."""


@dataclass(frozen=True, kw_only=True)
class PlacedFile:
    """A file in millimetres of its own frame, and how it is put into the canister frame.

    Turned over, then scaled, then shifted.
    """

    file: str
    """Path, relative to the scene file's folder or absolute."""
    place: Literal["given", "auto"] = "given"
    """``given``: where its coordinates say; ``auto``: upright, below the net pot's grid, in the middle of the water."""
    flip: bool = False
    """Turn it upside down (half a turn about x): for files whose z points down."""
    scale: float = bounded(1.0, 1e-6, 1e6)
    """Enlarge it, diameters too."""
    shift_mm: tuple[float, float, float] = bounded((0.0, 0.0, 0.0), -1e6, 1e6)
    """Move it, from where ``place`` puts it."""


@dataclass(frozen=True, kw_only=True)
class MeshSpecimen(PlacedFile):
    """A closed surface from a PLY, STL or OBJ file."""


@dataclass(frozen=True, kw_only=True)
class RsmlSpecimen(PlacedFile):
    """Traced roots from an RSML file (Lobet 2015)."""

    unit: str | None = None
    """mm, cm, m, um, inch, or a step such as "0.1 mm"; None: as the file's metadata say (refused when they do not)."""
    diameter_mm: float | None = field(default=None, metadata={"limits": (0.01, 50.0)})
    """Diameter of every root where the file gives none; None: refuse such a file."""


@dataclass(frozen=True, kw_only=True)
class RootOrder:
    """Growth parameters of the roots of one order (0: taproot), as architectural root models name them."""

    diameter_mm: float = bounded(0.3, 0.01, 50.0)
    """Mean diameter where the root begins, before the radii of the plant are scaled to its volume."""
    diameter_sd: float = bounded(0.1, 0.0, 0.5)
    """Standard deviation of that diameter between roots, as a fraction of it."""
    taper: float = bounded(0.6, 0.05, 1.0)
    """Diameter at the tip as a fraction of the diameter at the beginning; linear along the root."""
    elongation_mm_per_day: float = bounded(3.0, 0.01, 200.0)
    """Elongation of a new root; it slows down as the root nears its greatest length."""
    max_length_mm: float = bounded(60.0, 0.5, 2000.0)
    """Length that an average root reaches in the end."""
    length_sd: float = bounded(0.3, 0.0, 1.0)
    """Standard deviation of that length between roots, as a fraction of it; elongation varies with it."""
    interlateral_mm: float = bounded(4.0, 0.1, 1000.0)
    """Mean distance between neighbouring laterals along a root of this order."""
    interlateral_sd: float = bounded(0.4, 0.0, 1.0)
    """Standard deviation of that distance, as a fraction of it."""
    base_mm: float = bounded(2.0, 0.0, 1000.0)
    """Length without laterals where the root begins."""
    apex_mm: float = bounded(10.0, 0.0, 1000.0)
    """Length without laterals behind the tip: a lateral appears once the tip has passed it by this much."""
    insertion_deg: float = bounded(70.0, 0.0, 180.0)
    """Angle at which roots of this order leave their parent (taproot: unused)."""
    insertion_sd_deg: float = bounded(12.0, 0.0, 90.0)
    """Standard deviation of that angle."""
    gravitropism_per_mm: float = bounded(0.01, -0.5, 0.5)
    """Turn towards straight down (or the lean) per mm of growth, radians times the sine of the angle still to go."""
    wobble_deg: float = bounded(6.0, 0.0, 90.0)
    """Random change of heading over 1 mm; it grows with the square root of the length."""


@dataclass(frozen=True, kw_only=True)
class BasalRoots(RootOrder):
    """Growth parameters of roots that begin side by side at the top of the taproot.

    They are basal, seminal, nodal or adventitious.

    They bear laterals as the taproot does, the second of ``specimen.orders``.
    """

    count: int = bounded(6, 1, 200)
    """How many there are."""
    at_mm: float = bounded(0.0, 0.0, 1000.0)
    """Distance along the taproot from its beginning to where they begin ..."""
    zone_mm: float = bounded(2.0, 0.0, 1000.0)
    """... and the length of taproot over which they are spread."""
    delay_days: float = bounded(0.0, 0.0, 365.0)
    """Days after the taproot began that they begin."""


@dataclass(frozen=True, kw_only=True)
class GrownSpecimen:
    """A root system grown from the field's parameters, seeded."""

    seed: int = bounded(0, 0, 2**63 - 1)
    """Same seed, same plant; an older plant of the same seed continues the younger one."""
    age_days: float = bounded(15.0, 0.1, 365.0)
    """Days since the taproot began."""
    volume_ml: float = bounded(0.2, 1e-4, 500.0)
    """Volume of the union of all roots; all radii are scaled by one factor to reach it exactly."""
    orders: tuple[RootOrder, ...] = (
        RootOrder(diameter_mm=1.2, taper=0.3, elongation_mm_per_day=9.0, max_length_mm=95.0, interlateral_mm=2.0, wobble_deg=4.0),
        RootOrder(),
    )
    """Parameters of the taproot, of its laterals, of their laterals and so on."""
    basal: tuple[BasalRoots, ...] = ()
    """Kinds of roots beside the taproot that begin at its top."""
    origin_mm: tuple[float, float, float] = bounded((0.0, 0.0, -10.5), -1000.0, 1000.0)
    """Where the taproot begins; its rounded end reaches higher by its radius."""
    lean_deg: float = bounded(0.0, 0.0, 90.0)
    """Angle between straight down and the direction that the roots head for: a fallen plant's roots lie on the wall."""
    lean_azimuth_deg: float = bounded(0.0, -360.0, 360.0)
    """Azimuth towards which the roots lean, counter-clockwise from +x seen from above."""
    hypocotyl_diameter_mm: float = bounded(0.0, 0.0, 50.0)
    """Diameter of the thickened top of the taproot; 0: none."""
    hypocotyl_length_mm: float = bounded(10.0, 0.1, 500.0)
    """Length over which the thickened top fades into the taproot."""
    hypocotyl_shape: Literal["fading", "globe"] = "fading"
    """``fading``: thickest where it begins, as a carrot; ``globe``: thickest in its middle, as a bulb or a round
    radish."""
    buried_mm: float = bounded(1000.0, 0.0, 1000.0)
    """Laterals begin on their parent's axis, but no deeper below its surface than this: a storage root's tissue is laid
    down about them."""
    wall_margin_mm: float = bounded(0.5, 0.0, 100.0)
    """Water left free between a root's surface and the inner wall."""
    floor_margin_mm: float = bounded(0.5, 0.0, 1000.0)
    """Water left free between a root's surface and the floor."""
    top_margin_mm: float = bounded(0.5, 0.0, 100.0)
    """Water left free between a root's surface and the underside of the net pot's grid."""


Specimen = SphereSpecimen | MeshSpecimen | RsmlSpecimen | GrownSpecimen

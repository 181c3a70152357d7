"""Specimens: frozen descriptions of the object in the canister, with one class per kind of object."""

from dataclasses import dataclass, field
from typing import Literal

from rhizotwin.scenes.limits import bounded


@dataclass(frozen=True, kw_only=True)
class SphereSpecimen:
    """Sphere as a specimen."""

    diameter_mm: float = bounded(20.0, 0.1, 200.0)
    """Diameter of the sphere."""
    centre_mm: tuple[float, float, float] = bounded((0.0, 0.0, -55.0), -1000.0, 1000.0)
    """Centre of the sphere in the canister frame. Its origin is on the axis in the plane of the rim, and z points
    up."""


@dataclass(frozen=True, kw_only=True)
class PlacedFile:
    """File with coordinates in millimetres, and its placement in the canister frame.

    The coordinates are flipped, then scaled, then translated.
    """

    file: str
    """Path of the file, absolute or relative to the folder of the scene file."""
    place: Literal["given", "auto"] = "given"
    """Initial placement. ``given``: coordinates as in the file. ``auto``: upright, below the net pot's grid, in the
    middle of the water."""
    flip: bool = False
    """Whether to rotate the object by 180 degrees about the x axis. This is required for files in which z points
    down."""
    scale: float = bounded(1.0, 1e-6, 1e6)
    """Scale factor, which also applies to diameters."""
    shift_mm: tuple[float, float, float] = bounded((0.0, 0.0, 0.0), -1e6, 1e6)
    """Translation relative to the initial placement."""


@dataclass(frozen=True, kw_only=True)
class MeshSpecimen(PlacedFile):
    """Closed surface from a PLY, STL or OBJ file."""


@dataclass(frozen=True, kw_only=True)
class RsmlSpecimen(PlacedFile):
    """Traced roots from an RSML file (Lobet 2015)."""

    unit: str | None = None
    """Unit of the coordinates: mm, cm, m, um, inch, or a length such as "0.1 mm". If it is None, the unit in the
    metadata of the file is used, and a file without a unit is rejected."""
    diameter_mm: float | None = field(default=None, metadata={"limits": (0.01, 50.0)})
    """Diameter of roots for which the file states no diameter. If it is None, such files are rejected."""
    vertical_axis: Literal["x", "y", "z"] | None = None
    """Axis of the file along which the depth is measured. If it is None, it is z, or y in drawings: files with two
    coordinates, and with ``place = "auto"`` files with almost constant z."""


@dataclass(frozen=True, kw_only=True)
class RootOrder:
    """Growth parameters of all roots of one order.

    The taproot has order 0. The names are those of architectural root models.
    """

    diameter_mm: float = bounded(0.3, 0.01, 50.0)
    """Mean diameter at the base of the root, before the radii of the plant are scaled to its specified volume."""
    diameter_sd: float = bounded(0.1, 0.0, 0.5)
    """Standard deviation of the base diameter between roots, as a fraction of the mean."""
    taper: float = bounded(0.6, 0.05, 1.0)
    """Ratio of tip diameter to base diameter. The diameter changes linearly along the root."""
    elongation_mm_per_day: float = bounded(3.0, 0.01, 200.0)
    """Elongation rate of a new root. It decreases as the root approaches its final length."""
    max_length_mm: float = bounded(60.0, 0.5, 2000.0)
    """Mean final length of a root of this order."""
    length_sd: float = bounded(0.3, 0.0, 1.0)
    """Standard deviation of the final length between roots, as a fraction of the mean. The elongation rate of a root is
    proportional to its final length."""
    interlateral_mm: float = bounded(4.0, 0.1, 1000.0)
    """Mean distance between adjacent laterals along a root of this order."""
    interlateral_sd: float = bounded(0.4, 0.0, 1.0)
    """Standard deviation of the distance between adjacent laterals, as a fraction of the mean."""
    base_mm: float = bounded(2.0, 0.0, 1000.0)
    """Length of the zone without laterals at the base of the root."""
    apex_mm: float = bounded(10.0, 0.0, 1000.0)
    """Length of the zone without laterals behind the tip. A lateral emerges when the tip has grown beyond
    its point of attachment by this length."""
    insertion_deg: float = bounded(70.0, 0.0, 180.0)
    """Angle between a root of this order and its parent at the base. It is not used for the taproot."""
    insertion_sd_deg: float = bounded(12.0, 0.0, 90.0)
    """Standard deviation of the insertion angle."""
    gravitropism_per_mm: float = bounded(0.01, -0.5, 0.5)
    """Rotation of the growth direction per mm of growth towards straight down, or towards the direction given by the
    lean. It is in radians, divided by the sine of the remaining angle."""
    wobble_deg: float = bounded(6.0, 0.0, 90.0)
    """Random change of the growth direction. Over a length that is much larger than 4 mm, the standard deviation of the
    change is this value times the square root of the length in mm."""
    nutation_mm: float = bounded(0.0, 0.0, 50.0)
    """Radius of the circle that the root tip describes by circumnutation, counter-clockwise seen from above. The
    curvature of the growth zone is uniform, and its direction rotates (Bastien and Meroz 2016, PLoS Computational
    Biology 12:e1005238)."""
    nutation_h: float = bounded(2.0, 0.05, 1000.0)
    """Period of the circumnutation, in hours."""
    nutation_zone_mm: float = bounded(5.0, 0.1, 100.0)
    """Length of the zone behind the tip that bends by circumnutation."""


@dataclass(frozen=True, kw_only=True)
class BasalRoots(RootOrder):
    """Growth parameters of basal, seminal, nodal or adventitious roots. These roots emerge at the top of the taproot.

    Laterals of these roots have the parameters of the taproot's laterals, which are the second of ``specimen.orders``.
    """

    count: int = bounded(6, 1, 200)
    """Number of basal roots of this kind."""
    at_mm: float = bounded(0.0, 0.0, 1000.0)
    """Distance of the first of these roots from the base of the taproot, along the taproot."""
    zone_mm: float = bounded(2.0, 0.0, 1000.0)
    """Length of the part of the taproot in which these roots emerge."""
    delay_days: float = bounded(0.0, 0.0, 365.0)
    """Time from the emergence of the taproot to the emergence of these roots."""


@dataclass(frozen=True, kw_only=True)
class GrownSpecimen:
    """Root system grown from the parameters of an architectural root model."""

    seed: int = bounded(0, 0, 2**63 - 1)
    """Random seed of the plant. An older plant with the same seed continues the younger plant."""
    age_days: float = bounded(15.0, 0.1, 365.0)
    """Time since the emergence of the taproot."""
    volume_ml: float = bounded(0.2, 1e-4, 500.0)
    """Volume of the union of all roots. All radii are multiplied by a common factor, so that this volume is exact."""
    orders: tuple[RootOrder, ...] = (
        RootOrder(diameter_mm=1.2, taper=0.3, elongation_mm_per_day=9.0, max_length_mm=95.0, interlateral_mm=2.0, wobble_deg=4.0),
        RootOrder(),
    )
    """Growth parameters of the roots of each order: the taproot, its laterals, their laterals, and so on."""
    basal: tuple[BasalRoots, ...] = ()
    """Further kinds of roots that emerge at the top of the taproot."""
    half_growth_mmol_per_l: dict[str, float] = field(default_factory=dict, hash=False, metadata={"limits": (1e-9, 1000.0)})
    """Concentration of each ion at which roots grow at half of the rate, such as NO3 = 0.027. The elongation rates and
    final lengths are multiplied by the smallest ratio c / (c + half) of all given ions, where c is the concentration in
    the nutrient solution. Without an ion, growth does not depend on the nutrient solution. `volume_ml` and the
    parameters of the roots are those of a plant whose growth is not limited."""
    origin_mm: tuple[float, float, float] = bounded((0.0, 0.0, -10.5), -1000.0, 1000.0)
    """Position of the base of the taproot. A rounded end extends above the base by the radius of the taproot."""
    lean_deg: float = bounded(0.0, 0.0, 90.0)
    """Angle between straight down and the preferred growth direction. If the angle is large, the roots lie on the wall,
    like those of a plant that has fallen over."""
    lean_azimuth_deg: float = bounded(0.0, -360.0, 360.0)
    """Azimuth of the direction in which the roots lean, counter-clockwise from +x seen from above."""
    lean_until_days: float = bounded(365.0, 0.0, 365.0)
    """Age until which the roots follow the lean. Later growth turns straight down, like that of a plant that was tilted
    by the lean at this age (gravitropism)."""
    step_mm: float = bounded(1.0, 0.05, 1.0)
    """Length of a growth step. A smaller step lets roots turn within hours instead of once per mm, but the random
    curvature of the roots is another one."""
    hypocotyl_diameter_mm: float = bounded(0.0, 0.0, 50.0)
    """Diameter of the thickened top of the taproot. It is 0 if the taproot has none."""
    hypocotyl_length_mm: float = bounded(10.0, 0.1, 500.0)
    """Length over which the thickened top tapers to the diameter of the taproot."""
    hypocotyl_shape: Literal["fading", "globe"] = "fading"
    """Shape of the thickened top. ``fading``: thickest at the base, like a carrot. ``globe``: thickest in the middle,
    like a bulb or a round radish."""
    buried_mm: float = bounded(1000.0, 0.0, 1000.0)
    """Maximum depth below the surface of the parent at which laterals begin. If the centre line of the parent is less
    deep, they begin on the centre line. The tissue of a storage root grows around its laterals."""
    wall_margin_mm: float = bounded(0.5, 0.0, 100.0)
    """Minimum distance between a root's surface and the canister's inner wall."""
    floor_margin_mm: float = bounded(0.5, 0.0, 1000.0)
    """Minimum distance between the surface of a root and the floor of the water."""
    top_margin_mm: float = bounded(0.5, 0.0, 100.0)
    """Minimum distance between a root's surface and the underside of the net pot's grid."""


Specimen = SphereSpecimen | MeshSpecimen | RsmlSpecimen | GrownSpecimen

"""Grow a root system in the canister's water with an architectural root model.

The model follows Pages et al. 2004 (Plant and Soil 258:103) and Leitner et al. 2010 (Plant and Soil 332:177). Roots
elongate as L(t) = k (1 - exp(-r t / k)), bend by tropism and random curvature, and form laterals in acropetal order at
random distances. All roots of an order grow together as arrays. The random values of a root come from a generator
seeded with the root's path (child numbers from the taproot on), so that a root does not depend on the number of other
roots.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rhizotwin.scenes import polyline
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.model import Canister, NetPot
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.specimens import BasalRoots, GrownSpecimen, RootOrder
from rhizotwin.sim.confinement import Bounds, bounds, keep_inside, steer
from rhizotwin.sim.elongation import age_at, length_at

Array = NDArray[np.float64]

DOWN = np.array([0.0, 0.0, -1.0])
"""Direction of gravity, canister frame."""
BEND_LENGTH_MM = 4.0
"""Correlation length of the random curvature of a root, mm. It makes the growth direction vary smoothly."""
MOST_ROOTS = 20_000
"""Maximum number of roots. A mesh of more roots would need many minutes and several gigabytes."""
HEADING_FAN_DEG = 137.5
"""Mean difference between the azimuths of successive laterals, deg. This golden angle distributes laterals evenly
around the root."""
HEADING_FAN_SD_DEG = 40.0
"""Standard deviation of the difference between the azimuths of successive laterals, deg."""
BASAL_KIND = 1_000_000
"""Difference between the first child numbers of successive kinds of basal roots. The child numbers of kind k = 1, 2,
... begin at k times this value. They exceed the child numbers of all laterals."""


class _GrownBud(NamedTuple):
    """Root that has grown from a bud, with its growth parameters."""

    root: Root | None
    """Grown root. It is None if the root is too short to emerge."""
    length_mm: float
    """Current length of the root, mm."""
    max_length_mm: float
    """Final length of the root, mm."""
    elongation_mm_per_day: float
    """Initial growth rate of the root, mm/day."""


@dataclass(frozen=True, kw_only=True)
class _Bud:
    """Root that has not grown yet, with its initial position and direction."""

    path: tuple[int, ...]
    """Child numbers along the path from the taproot to this root. They are empty for the taproot."""
    parent: int
    """Index of the parent root. It is -1 if there is no parent."""
    order: int
    """Order of the root. It is 0 for a root without a parent."""
    start_mm: Array
    """Base of the root (3,), mm, canister frame."""
    heading: Array
    """Unit vector of the initial growth direction (3,)."""
    age_days: float
    """Time since the emergence of the root, days."""
    limit_diameter_mm: float
    """Maximum diameter of the root, mm."""


def grow(specimen: GrownSpecimen, *, canister: Canister | None = None, net_pot: NetPot | None = None) -> list[Root]:
    """Grow a plant. The same specimen always yields the same plant, which grows further if its age is increased.

    Parameters
    ----------
    specimen : GrownSpecimen
        Seed, age, and parameters of each order. ``volume_ml`` is not used.
    canister, net_pot : Canister or None, NetPot or None
        Canister and net pot that limit the growth. None: those of the default rig.

    Returns
    -------
    list of Root
        Roots, with the taproot first and parents before children, in the canister frame. Points are about ``step_mm``
        apart. Diameters are not yet scaled to the plant's volume. Root surfaces keep the margins from wall, floor and
        grid.

    Raises
    ------
    UserError
        If the base of the taproot lies outside the limits, or the plant would have more than `MOST_ROOTS` roots.
    """
    limits = bounds(specimen, canister=canister or Canister(), net_pot=net_pot or NetPot())
    _check_origin(specimen, limits)
    lean_rad, azimuth_rad = np.deg2rad([specimen.lean_deg, specimen.lean_azimuth_deg])
    lean = np.array([np.sin(lean_rad) * np.cos(azimuth_rad), np.sin(lean_rad) * np.sin(azimuth_rad), -np.cos(lean_rad)])
    buds = [
        _Bud(
            path=(),
            parent=-1,
            order=0,
            start_mm=np.array(specimen.origin_mm),
            heading=lean,
            age_days=specimen.age_days,
            limit_diameter_mm=np.inf,
        )
    ]
    roots: list[Root] = []
    for number, order in enumerate(specimen.orders):
        following = specimen.orders[number + 1] if number + 1 < len(specimen.orders) else None
        children: list[_Bud] = []
        together: list[tuple[list[_Bud], RootOrder]] = [(buds, order)]
        while together:
            kin, own = together.pop(0)
            for bud, grown in zip(kin, _grow_order(kin, own, specimen, limits, lean), strict=True):
                root = grown.root
                if root is None:
                    continue
                if bud.parent < 0:
                    together += [(_place_basal(bud, root, kind, specimen), specimen.basal[kind]) for kind in range(len(specimen.basal))]
                if following is not None:
                    children += _place_laterals(bud, grown, len(roots), own, following, specimen)
                roots.append(root)
            if len(roots) + len(children) > MOST_ROOTS:
                raise UserError(
                    f"specimen.orders results in more than {MOST_ROOTS} roots on day {specimen.age_days:g}; "
                    "increase interlateral_mm or reduce max_length_mm."
                )
        buds = children
    return roots


def _check_origin(specimen: GrownSpecimen, limits: Bounds) -> None:
    radius_mm = max(specimen.orders[0].diameter_mm, specimen.hypocotyl_diameter_mm) / 2.0 if specimen.orders else 0.0
    x, y, z = specimen.origin_mm
    if not specimen.orders:
        raise UserError("specimen.orders is empty; add a section [[specimen.orders]] with the parameters of the taproot.")
    if z + radius_mm > limits.high_z_mm or z - radius_mm < limits.low_z_mm or np.hypot(x, y) + radius_mm > limits.radius_mm:
        raise UserError(
            f"specimen.origin_mm {specimen.origin_mm} is too close to the edge of the water; a root of diameter "
            f"{2.0 * radius_mm:.2f} mm must begin at least {radius_mm:.2f} mm inside z {limits.low_z_mm:.1f} to "
            f"{limits.high_z_mm:.1f} mm and radius {limits.radius_mm:.1f} mm."
        )


def _generators(seed: int, path: tuple[int, ...]) -> tuple[np.random.Generator, np.random.Generator, np.random.Generator]:
    """Return three random generators.

    They are for the traits of a root, for its curvature and for its laterals, in this order.
    """
    shape, wobble, laterals = np.random.SeedSequence(entropy=seed, spawn_key=path).generate_state(3, np.uint64)
    return np.random.default_rng(int(shape)), np.random.default_rng(int(wobble)), np.random.default_rng(int(laterals))


def _draw_factor(rng: np.random.Generator, sd: float) -> float:
    """Draw a positive factor with mean 1 and relative standard deviation ``sd`` from a gamma distribution."""
    return float(rng.gamma(1.0 / sd**2, sd**2)) if sd > 0.0 else 1.0


def _grow_order(buds: list[_Bud], order: RootOrder, specimen: GrownSpecimen, limits: Bounds, lean: Array) -> list[_GrownBud]:
    """Grow the buds of all roots of one order."""
    if not buds:
        return []
    traits, phases_rad = np.empty((len(buds), 3)), np.empty(len(buds))
    for i, bud in enumerate(buds):
        rng = _generators(specimen.seed, bud.path)[0]
        factor = max(_draw_factor(rng, order.length_sd), 0.05)
        traits[i] = (
            factor * order.max_length_mm,
            factor * order.elongation_mm_per_day,
            order.diameter_mm * _draw_factor(rng, order.diameter_sd),
        )
        phases_rad[i] = rng.uniform(0.0, 2.0 * np.pi) + 2.0 * np.pi * 24.0 * specimen.age_days / order.nutation_h
    ages = np.array([bud.age_days for bud in buds])
    lengths_mm = length_at(ages, max_length_mm=traits[:, 0], elongation_mm_per_day=traits[:, 1])
    thickest = np.minimum(traits[:, 2], [bud.limit_diameter_mm for bud in buds])
    room_mm = np.maximum(traits[:, 2], specimen.hypocotyl_diameter_mm if buds[0].parent < 0 else 0.0) / 2.0
    gravity = _directions(ages, lengths_mm, traits, specimen, lean)
    points_mm = _centrelines(buds, order, gravity, lengths_mm, room_mm, specimen, limits)
    grown: list[_GrownBud] = []
    for i, bud in enumerate(buds):
        root = None
        if lengths_mm[i] > max(0.3, thickest[i]):  # shorter roots are still inside their parents
            line_mm, along_mm = _cut(points_mm[i], lengths_mm[i], specimen.step_mm)
            if order.nutation_mm > 0.0:
                line_mm = _nutate(line_mm, along_mm, order, bud.heading, phases_rad[i])
                line_mm = keep_inside(line_mm, np.full(len(line_mm), room_mm[i]), limits)
            diameters_mm = thickest[i] * (1.0 + (order.taper - 1.0) * along_mm / lengths_mm[i])
            if bud.parent < 0 and specimen.hypocotyl_diameter_mm > 0.0:
                diameters_mm = np.maximum(diameters_mm, _thicken_top(diameters_mm, along_mm, specimen))
            label = ".".join(str(child + 1) for child in (0, *bud.path))
            root = Root(points_mm=line_mm, diameters_mm=diameters_mm, order=bud.order, parent=bud.parent, label=label)
        grown.append(_GrownBud(root, float(lengths_mm[i]), float(traits[i, 0]), float(traits[i, 1])))
    return grown


def _thicken_top(diameters_mm: Array, along_mm: Array, specimen: GrownSpecimen) -> Array:
    """Return the diameters of the thickened top at the points of the taproot (N,), mm."""
    fade = np.clip(along_mm / specimen.hypocotyl_length_mm, 0.0, 1.0)
    if specimen.hypocotyl_shape == "globe":  # ellipsoid of revolution
        return specimen.hypocotyl_diameter_mm * 2.0 * np.sqrt(fade * (1.0 - fade))
    return diameters_mm + (specimen.hypocotyl_diameter_mm - diameters_mm) * 0.5 * (1.0 + np.cos(np.pi * fade))


def _cut(points_mm: Array, length_mm: float, step_mm: float) -> tuple[Array, Array]:
    """Cut a centre line at a given length.

    The centre line has a point every ``step_mm``. Return the points (N, 3) up to this length, and their arc lengths
    (N,), mm.
    """
    whole = max(int(np.ceil(length_mm / step_mm - 1e-9)), 1)
    along_mm = np.minimum(np.arange(whole + 1) * step_mm, length_mm)
    line_mm = points_mm[: whole + 1].copy()
    line_mm[-1] = points_mm[whole - 1] + (points_mm[whole] - points_mm[whole - 1]) * (along_mm[-1] - along_mm[-2]) / step_mm
    if whole > 1 and along_mm[-1] - along_mm[-2] < 0.25 * step_mm:  # avoids a very short segment at the tip
        line_mm, along_mm = np.delete(line_mm, -2, axis=0), np.delete(along_mm, -2)
    return line_mm, along_mm


def _nutate(line_mm: Array, along_mm: Array, order: RootOrder, heading: Array, phase_rad: float) -> Array:
    """Displace the points (N, 3) of the growth zone by circumnutation.

    A uniform curvature displaces a point by the square of its distance from the beginning of the zone. ``heading`` is
    the initial direction of the root, which determines the direction of phase 0.
    """
    begin_mm = max(along_mm[-1] - order.nutation_zone_mm, 0.0)
    axis = polyline.unit_vectors(line_mm[-1] - polyline.interpolate(line_mm, along_mm, np.array([begin_mm]))[0])
    level = np.cross(heading, DOWN)  # horizontal, and perpendicular to the root while it turns down
    level = level if np.linalg.norm(level) > 1e-6 else np.array([1.0, 0.0, 0.0])
    side = polyline.unit_vectors(level - (level @ axis) * axis)
    side = np.cos(phase_rad) * side + np.sin(phase_rad) * np.cross(side, axis)
    reach = np.clip(along_mm - begin_mm, 0.0, None) / order.nutation_zone_mm
    return np.asarray(line_mm + order.nutation_mm * reach[:, None] ** 2 * side)


def _directions(ages_days: Array, lengths_mm: Array, traits: Array, specimen: GrownSpecimen, lean: Array) -> Array:
    """Return the preferred growth direction (N, S, 3) of roots in each of their growth steps.

    It is that of the lean up to an age of the plant, and straight down from then on.
    """
    begin_mm = np.arange(int(np.ceil(lengths_mm.max() / specimen.step_mm)) + 1) * specimen.step_mm
    most_mm, rates = traits[:, :1], traits[:, 1:2]
    own_days = age_at(np.minimum(begin_mm, 0.999999 * most_mm), max_length_mm=most_mm, elongation_mm_per_day=rates)
    leans = specimen.age_days - ages_days[:, None] + own_days < specimen.lean_until_days
    return np.where(leans[..., None], lean, DOWN)


def _centrelines(
    buds: list[_Bud], order: RootOrder, gravity: Array, lengths_mm: Array, radii_mm: Array, specimen: GrownSpecimen, limits: Bounds
) -> Array:
    """Return the centre lines (N, S + 1, 3) of all buds, mm.

    Each has as many points as the longest root requires. ``gravity`` (N, S, 3) is their preferred growth direction.
    """
    steps, step_mm = gravity.shape[1], specimen.step_mm
    bend = np.zeros((len(buds), steps, 3))
    for i, bud in enumerate(buds):
        own = min(int(np.ceil(lengths_mm[i] / step_mm)) + 1, steps)
        bend[i, :own] = _generators(specimen.seed, bud.path)[1].standard_normal((own, 3))
    persistence = np.exp(-step_mm / BEND_LENGTH_MM)
    # Curvature is an Ornstein-Uhlenbeck process. Beyond its correlation length, the variance of the growth direction
    # increases by wobble^2 per mm.
    curvature_sd = np.deg2rad(order.wobble_deg) / np.sqrt(2.0 * BEND_LENGTH_MM)
    points_mm = np.empty((len(buds), steps + 1, 3))
    points_mm[:, 0] = [bud.start_mm for bud in buds]
    heading = np.array([bud.heading for bud in buds])
    curvature = curvature_sd * bend[:, 0]
    for step in range(steps):
        turn = curvature + order.gravitropism_per_mm * gravity[:, step]
        turn -= np.sum(turn * heading, axis=1, keepdims=True) * heading
        heading = heading + step_mm * turn
        heading /= np.linalg.norm(heading, axis=1, keepdims=True)
        heading = steer(points_mm[:, step], heading, radii_mm, limits)
        points_mm[:, step + 1] = keep_inside(points_mm[:, step] + step_mm * heading, radii_mm, limits)
        curvature = persistence * curvature + curvature_sd * np.sqrt(1.0 - persistence**2) * bend[:, min(step + 1, steps - 1)]
    return points_mm


def _place_basal(bud: _Bud, taproot: Root, kind: int, specimen: GrownSpecimen) -> list[_Bud]:
    """Place the buds of one kind of basal roots on the taproot.

    The buds are evenly spaced along the zone of these roots. Around the taproot, the azimuths of successive buds differ
    by `HEADING_FAN_DEG` on average.
    """
    basal: BasalRoots = specimen.basal[kind]
    children: list[_Bud] = []
    for number in range(basal.count):
        path = ((kind + 1) * BASAL_KIND + number,)
        rng = _generators(specimen.seed, path)[2]
        azimuth_rad = np.deg2rad(number * HEADING_FAN_DEG + rng.normal(0.0, HEADING_FAN_SD_DEG))
        insertion_rad = np.deg2rad(np.clip(rng.normal(basal.insertion_deg, basal.insertion_sd_deg), 5.0, 175.0))
        at_mm = basal.at_mm + basal.zone_mm * (number + 0.5) / basal.count
        insertion = _Insertion(at_mm, azimuth_rad, insertion_rad, specimen.buried_mm)
        children.append(_place_bud(bud, taproot, 0, path, insertion, age_days=bud.age_days - basal.delay_days))
    return children


def _place_laterals(bud: _Bud, grown: _GrownBud, index: int, order: RootOrder, following: RootOrder, specimen: GrownSpecimen) -> list[_Bud]:
    """Place the buds of a root's laterals.

    There are none in the zones at the base and the tip of the root (``base_mm``, ``apex_mm``).
    """
    root, length_mm, max_length_mm, elongation_mm_per_day = grown
    if root is None:
        return []
    rng = _generators(specimen.seed, bud.path)[2]
    azimuth_rad = rng.uniform(0.0, 2.0 * np.pi)
    at_mm = order.base_mm
    buds: list[_Bud] = []
    while True:
        at_mm += order.interlateral_mm * max(_draw_factor(rng, order.interlateral_sd), 0.05)
        azimuth_rad += np.deg2rad(rng.normal(HEADING_FAN_DEG, HEADING_FAN_SD_DEG))
        insertion_rad = np.deg2rad(np.clip(rng.normal(following.insertion_deg, following.insertion_sd_deg), 5.0, 175.0))
        if at_mm + order.apex_mm >= length_mm:
            return buds
        passed_mm = np.array(at_mm + order.apex_mm)
        began_days = age_at(passed_mm, max_length_mm=np.array(max_length_mm), elongation_mm_per_day=np.array(elongation_mm_per_day))
        path = (*bud.path, len(buds))
        insertion = _Insertion(at_mm, azimuth_rad, insertion_rad, specimen.buried_mm)
        buds.append(_place_bud(bud, root, index, path, insertion, age_days=bud.age_days - float(began_days)))


class _Insertion(NamedTuple):
    """Place and initial direction of a bud on its parent root."""

    at_mm: float
    """Distance along the parent, mm."""
    azimuth_rad: float
    """Azimuth about the parent, rad."""
    insertion_rad: float
    """Angle from the direction of the parent, rad."""
    buried_mm: float
    """Depth of the base of the root below the surface of the parent, mm."""


def _place_bud(bud: _Bud, root: Root, index: int, path: tuple[int, ...], insertion: _Insertion, *, age_days: float) -> _Bud:
    """Return a bud at its place on its parent root."""
    at_mm, azimuth_rad, insertion_rad, buried_mm = insertion
    ladder_mm = polyline.arc_length_mm(root.points_mm)
    segment = int(np.clip(np.searchsorted(ladder_mm, at_mm, side="right") - 1, 0, len(ladder_mm) - 2))
    part = np.clip((at_mm - ladder_mm[segment]) / (ladder_mm[segment + 1] - ladder_mm[segment]), 0.0, 1.0)
    along = root.points_mm[segment + 1] - root.points_mm[segment]
    along /= np.linalg.norm(along)
    across = np.cross(along, [1.0, 0.0, 0.0] if abs(along[0]) < 0.7 else [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    side = np.cos(azimuth_rad) * across + np.sin(azimuth_rad) * np.cross(along, across)
    diameter_mm = float((1.0 - part) * root.diameters_mm[segment] + part * root.diameters_mm[segment + 1])
    on_axis = root.points_mm[segment] + part * (root.points_mm[segment + 1] - root.points_mm[segment])
    return _Bud(
        path=path,
        parent=index,
        order=bud.order + 1,
        start_mm=on_axis + max(0.0, diameter_mm / 2.0 - buried_mm) * side,
        heading=np.cos(insertion_rad) * along + np.sin(insertion_rad) * side,
        age_days=age_days,
        limit_diameter_mm=0.95 * diameter_mm,
    )

"""Small random scans: a random subject, rings, picture size and number of views, with the errors of a random profile.

Subjects are phantoms, and plants of random seed and age, so that no setting was ever chosen on one of them. One scan in
six has a random half of the disturbances of the profile `real`, each with a random magnitude.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rhizotwin.bench.benchmarks import HIGH_RING
from rhizotwin.scenes.disturbances import Disturbances
from rhizotwin.scenes.files import load_profile, load_scene
from rhizotwin.scenes.model import CapturePlan, Ring, Scene
from rhizotwin.scenes.specimens import GrownSpecimen, RootOrder, Specimen, SphereSpecimen

PROFILES = ("clean", "bench", "camera", "harsh", "real", "mixture")
"""Profiles in turn; ``mixture`` is `camera` with a random selection of the disturbances of `real`."""
FAMILIES: dict[str, int] = {
    "sphere_20mm": 1,
    "printed_8ml": 2,
    "taproot": 3,
    "radish": 3,
    "fallen_plant": 1,
    "bean": 1,
    "maize": 1,
    "wheat": 1,
    "lettuce": 1,
    "bulb": 1,
    "carrot": 1,
    "radish_swollen": 1,
}
"""Subjects with their weights. ``taproot`` is a coarse random plant (`draw_taproot`), ``radish`` one of `RADISHES`."""
RADISHES = tuple(f"radish_day{day:02d}a" for day in (5, 10, 15, 20, 25, 30))
SIZES: dict[tuple[int, int], float] = {(320, 240): 0.3, (400, 300): 0.25, (480, 360): 0.2, (640, 480): 0.15, (800, 600): 0.1}
"""Picture sizes in px with their probabilities: small pictures are more frequent, as they take less time."""
VIEWS = 12, 60
"""Range of the total number of views; the draw is uniform in its logarithm."""
AGE = 0.7, 1.3
"""Range of a plant's age relative to the plant of the library."""
AGE_POWER = 2.0
"""Exponent of the root volume's growth with age: that of the radishes of the library from day 5 to day 30 is 2.2."""
SPHERE_MM = 6.0, 24.0
"""Range of sphere diameters, mm."""
SPHERE_OFF_AXIS_MM = 12.0
"""Maximum distance of a sphere's centre from the axis along x and y, mm."""
SECOND_RING = Ring(height_mm=-20.0, tilt_deg=5.0, first_deg=4.5)
"""Lowest second ring; the highest is `HIGH_RING`."""
DOSE = 0.25, 1.5
"""Range of magnitudes relative to `real`: from almost none to 1.5 times as much."""
TROUBLES: dict[str, tuple[str, ...]] = {
    "tube": ("canister_radius_error_mm", "canister_out_of_round_mm", "wall_error", "n_wall_error"),
    "seam": ("seam_opacity",),
    "dust": ("dust_specks", "scratches"),
    "highlight": ("highlight",),
    "glass": ("root_mu_per_mm",),
    "hairs": ("root_hair_mu_per_mm",),
    "sway": ("sway_mm",),
    "seat": ("strip_offset_mm", "strip_tilt_deg", "focal_error"),
    "algae": ("algae_patches", "algae_opacity"),
    "turbidity": ("turbidity_per_mm",),
    "floating": ("felt_fibres", "bubbles"),
}
"""Fields of `Disturbances` that are selected together; their magnitudes are drawn separately."""
SIGNED = ("canister_radius_error_mm", "wall_error", "n_wall_error", "focal_error")
"""Fields with random signs."""
WITH: dict[str, tuple[str, ...]] = {"glass": ("root_n",), "hairs": ("root_hair_mm",)}
"""Fields used with their values in the profile."""
_DRAW = 46
"""Seed of all draws."""


@dataclass(frozen=True, kw_only=True)
class RandomScan:
    """Pictures of one random scan."""

    number: int

    def _rng(self, part: int) -> np.random.Generator:
        return np.random.default_rng([_DRAW, self.number, part])

    @property
    def seed(self) -> int:
        """Random seed of the rendering."""
        return self.number

    @property
    def profile(self) -> str:
        """Profile of the rig's errors."""
        return PROFILES[self.number % len(PROFILES)]

    @property
    def family(self) -> str:
        """Name of the kind of subject."""
        weights = np.array(list(FAMILIES.values()), dtype=float)
        return str(self._rng(0).choice(list(FAMILIES), p=weights / weights.sum()))

    @property
    def image_wh(self) -> tuple[int, int]:
        """Picture size in px."""
        return list(SIZES)[int(self._rng(1).choice(len(SIZES), p=list(SIZES.values())))]

    def troubles(self) -> tuple[str, ...]:
        """Return the names of the selected disturbances of `real`."""
        rng = self._rng(2)
        chosen = tuple(name for name in TROUBLES if rng.random() < 0.5)
        return {"real": tuple(TROUBLES), "mixture": chosen}.get(self.profile, ())

    def rings(self) -> tuple[Ring, ...]:
        """Return one or two rings with their views."""
        rng, first = self._rng(3), load_scene("printed_8ml").plan.rings[0]
        views = round(float(np.exp(rng.uniform(*np.log(VIEWS)))))
        if rng.random() < 0.5:
            return (replace(first, views=views),)
        share, half = float(rng.random()), max(VIEWS[0] // 2, views // 2)
        second = replace(
            SECOND_RING,
            views=half,
            distance_mm=first.distance_mm,
            height_mm=SECOND_RING.height_mm + share * (HIGH_RING.height_mm - SECOND_RING.height_mm),
            tilt_deg=SECOND_RING.tilt_deg + share * (HIGH_RING.tilt_deg - SECOND_RING.tilt_deg),
        )
        return replace(first, views=half), second

    def scene_to_render(self) -> Scene:
        """Return the scene with subject, plan and disturbances."""
        name, specimen = self._subject()
        scene = load_scene(name)
        return replace(
            scene,
            name=f"random_{self.number}",
            description="",
            camera=scene.camera.resized(self.image_wh),
            plan=CapturePlan(rings=self.rings()),
            specimen=specimen,
            disturbances=self._disturbances(),
        )

    def _subject(self) -> tuple[str, Specimen]:
        """Return the scene of the library, and the specimen."""
        rng = self._rng(4)
        if self.family == "taproot":
            return "printed_8ml", draw_taproot(rng)
        name = str(rng.choice(RADISHES)) if self.family == "radish" else self.family
        specimen = load_scene(name).specimen
        if specimen is None:
            raise ValueError(f"scene {name} has no specimen")
        if isinstance(specimen, SphereSpecimen):
            x_mm, y_mm = rng.uniform(-SPHERE_OFF_AXIS_MM, SPHERE_OFF_AXIS_MM, size=2)
            return name, replace(
                specimen, diameter_mm=float(rng.uniform(*SPHERE_MM)), centre_mm=(float(x_mm), float(y_mm), specimen.centre_mm[2])
            )
        if isinstance(specimen, GrownSpecimen):
            older = float(rng.uniform(*AGE))
            return name, replace(
                specimen,
                seed=int(rng.integers(2**31)),
                age_days=specimen.age_days * older,
                volume_ml=specimen.volume_ml * older**AGE_POWER,
            )
        return name, specimen

    def _disturbances(self) -> Disturbances:
        if self.profile != "mixture":
            return load_profile(self.profile)
        rng, wrong, real = self._rng(5), load_profile("camera"), load_profile("real")
        for trouble in self.troubles():
            changes: dict[str, Any] = {field: getattr(real, field) for field in WITH.get(trouble, ())}
            for field in TROUBLES[trouble]:
                value = getattr(real, field)
                dosed = value * float(rng.uniform(*DOSE)) * (rng.choice((-1.0, 1.0)) if field in SIGNED else 1.0)
                changes[field] = round(dosed) if isinstance(value, int) else dosed
            wrong = replace(wrong, **changes)
        return wrong


def draw_taproot(rng: np.random.Generator) -> GrownSpecimen:
    """Draw a taproot of 2 to 6 mm with laterals of 0.8 to 2.2 mm, and some of the second order."""
    tap_mm, lateral_mm = rng.uniform(2.0, 6.0), rng.uniform(0.8, 2.2)
    length_mm = rng.uniform(50.0, 95.0)
    tap = RootOrder(
        diameter_mm=tap_mm,
        taper=rng.uniform(0.25, 0.6),
        elongation_mm_per_day=10.0,
        max_length_mm=length_mm,
        interlateral_mm=rng.uniform(3.0, 12.0),
        base_mm=6.0,
        apex_mm=10.0,
        gravitropism_per_mm=0.02,
        wobble_deg=rng.uniform(1.0, 4.0),
    )
    lateral = RootOrder(
        diameter_mm=lateral_mm,
        taper=rng.uniform(0.5, 0.8),
        elongation_mm_per_day=6.0,
        max_length_mm=rng.uniform(20.0, 55.0),
        interlateral_mm=rng.uniform(10.0, 40.0),
        insertion_deg=rng.uniform(40.0, 80.0),
        gravitropism_per_mm=rng.uniform(0.0, 0.02),
        wobble_deg=rng.uniform(2.0, 5.0),
    )
    fine = replace(lateral, diameter_mm=0.7 * lateral_mm, max_length_mm=15.0)
    # A cylinder for the taproot and about ten laterals of 20 mm; all radii are scaled to this volume, so that it is
    # only approximate.
    volume_mm3 = np.pi / 4.0 * (length_mm * (0.7 * tap_mm) ** 2 + 10.0 * 20.0 * (0.8 * lateral_mm) ** 2)
    return GrownSpecimen(
        seed=int(rng.integers(2**31)),
        age_days=float(rng.uniform(10.0, 20.0)),
        volume_ml=float(volume_mm3 / 1000.0),
        orders=(tap, lateral, fine),
        origin_mm=(0.0, 0.0, -17.5),
        floor_margin_mm=34.0,
    )

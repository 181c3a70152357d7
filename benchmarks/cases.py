"""Cases of the accuracy ladder: scenes, disturbances, seeds, pictures and methods."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from itertools import product
from typing import Literal

from rhizotwin.bench import benchmarks
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.files import library, load_scene
from rhizotwin.scenes.model import Scene

Method = Literal["coverage", "thesis"]

METHODS: tuple[Method, ...] = ("coverage", "thesis")
DEFAULT_VOXEL_MM = 0.27
"""Voxel size of the thesis, and default of the reconstruction."""

THIN_FAMILIES = ("bean", "maize", "wheat", "lettuce")
THICK_FAMILIES = ("bulb", "carrot", "radish_swollen")
"""Storage organs that bear roots."""
FAMILIES = (*THIN_FAMILIES, *THICK_FAMILIES)
PLANTS = ("radish_*", "fallen_plant", *FAMILIES)
"""Scenes with individual roots, for which a seed grows another specimen; phantoms do not change."""
PHANTOMS = ("sphere_20mm", "printed_8ml")
PROFILES = ("clean", "bench", "harsh")
ONE_RING: dict[str, tuple[Literal[1, 2], ...]] = dict.fromkeys(PROFILES, (1,))
LADDER: dict[str, dict[str, tuple[Literal[1, 2], ...]]] = {
    **dict.fromkeys(PHANTOMS, ONE_RING),
    "radish_day*b": {"clean": (1, 2), "bench": (1, 2), "harsh": (2,)},
    "radish_day*": {"clean": (1,)},
    **{scene: {"clean": (1, 2), "bench": (2,)} for scene in ("fallen_plant", *FAMILIES)},
}
"""Numbers of rings in each profile, by scenes (patterns, of which the first counts). One of the three radishes of each
age is measured with all disturbances and in two rings."""

NIGHTLY = ("radish_day20b", "radish_day30c", "wheat")
"""Dense root systems, measured every night in one ring: small plants do not show that fine roots are lost."""

SEED_SETS: dict[str, tuple[int, ...]] = {"first": (0,), "second": (101, 102)}
"""Named sets of seeds. ``second`` is for final tests only, and never used during development: its plants are new to the
method."""
CAMERA_SIZES: dict[str, tuple[tuple[int, int], ...]] = {"bean": ((1014, 760), (2028, 1520))}
"""Additional picture sizes of the recommended camera (a quarter and a half of 4056x3040), beside 800x600, for some
scenes: clean only."""


@dataclass(frozen=True, kw_only=True)
class Pictures:
    """A dataset to render."""

    scene: str
    profile: str = "clean"
    rings: Literal[1, 2] = 1
    """Number of rings. 1: the scene's own plan; 2: its first ring, and `benchmarks.HIGH_RING` at the same distance."""
    views: int = 40
    """Number of views in each ring."""
    image_wh: tuple[int, int] = (800, 600)
    seed: int = 0
    """Random seed of all disturbances, and of the plant if there is one."""
    sway_mm: float = 0.0
    """Sway of the roots' tips between the pictures (standard deviation), in addition to the profile, mm."""

    @property
    def name(self) -> str:
        """Short name for keys and messages."""
        rings = "" if self.rings == 1 else f"{self.rings}x"
        seed = "" if self.seed == 0 else f"/seed{self.seed}"
        sway = "" if self.sway_mm == 0.0 else f"/sway{self.sway_mm:g}"
        return f"{self.scene}/{self.profile}/{rings}{self.views}x{self.image_wh[0]}x{self.image_wh[1]}{seed}{sway}"

    @property
    def is_plant(self) -> bool:
        """Return whether the scene has individual roots."""
        return any(fnmatchcase(self.scene, pattern) for pattern in PLANTS)

    @property
    def has_roots(self) -> bool:
        """Return whether the truth contains centre lines, of a plant or of a printed root."""
        return self.scene != "sphere_20mm"

    def scene_to_render(self) -> Scene:
        """Return the library's scene with this plant, these views, this sensor and the profile's disturbances."""
        scene = benchmarks.rendered_scene(
            load_scene(self.scene), self.profile, rings=self.rings, views=self.views, image_wh=self.image_wh, seed=self.seed * self.is_plant
        )
        return replace(scene, disturbances=replace(scene.disturbances, sway_mm=self.sway_mm)) if self.sway_mm else scene


@dataclass(frozen=True, kw_only=True)
class Case:
    """One reconstruction to be scored."""

    pictures: Pictures
    voxel_mm: float = DEFAULT_VOXEL_MM
    method: Method = "coverage"

    @property
    def name(self) -> str:
        """Prefix of the keys of this case's metrics."""
        return f"{self.pictures.name}/{self.voxel_mm:g}/{self.method}"


def quick(*, scenes: Sequence[str] = ("*",), profiles: Sequence[str] = PROFILES, methods: Sequence[Method] = METHODS) -> list[Case]:
    """Return the small cases that are run for every change, or a selection.

    They are a solid, a printed phantom on a real bench by both methods, the pictures of the demo, a bulb, and thin
    roots.

    Parameters
    ----------
    scenes, profiles : sequence of str
        Patterns of names; matching cases are selected.
    methods : sequence of Method
        Selected methods.

    Returns
    -------
    list of Case
        The cases, in a fixed order.

    Raises
    ------
    UserError
        If no case matches.
    """
    small = (400, 300)
    sphere, bench, demo, bulb, plant = (
        Pictures(scene="sphere_20mm", views=24, image_wh=small),
        Pictures(scene="printed_8ml", profile="bench", image_wh=small),
        Pictures(scene="printed_8ml"),
        Pictures(scene="bulb", profile="bench", image_wh=small),
        Pictures(scene="radish_day05a", rings=2, views=20),  # in smaller pictures its roots are too thin for tubes
    )
    every = [
        *(Case(pictures=pictures) for pictures in (sphere, bench, demo, bulb, plant)),
        Case(pictures=bench, method="thesis"),
    ]
    return _some([case for case in every if case.pictures.profile in profiles and case.method in methods], scenes, profiles)


def _some(cases: list[Case], scenes: Sequence[str], profiles: Sequence[str]) -> list[Case]:
    """Return the cases of scenes whose names match a pattern; raise UserError if there are none."""
    chosen = [case for case in cases if any(fnmatchcase(case.pictures.scene, pattern) for pattern in scenes)]
    if not chosen:
        raise UserError(f"no case of the ladder has scenes {', '.join(scenes)} in profiles {', '.join(profiles)}; --list names them")
    return chosen


def nightly() -> list[Case]:
    """Return the dense root systems of every night: clean pictures in one ring, by our method."""
    return ladder(scenes=NIGHTLY, profiles=("clean",), rings=(1,), methods=("coverage",))


def ladder(
    *,
    scenes: Sequence[str] = ("*",),
    profiles: Sequence[str] = PROFILES,
    rings: Sequence[Literal[1, 2]] = (1, 2),
    seeds: Sequence[int] = SEED_SETS["first"],
    methods: Sequence[Method] = METHODS,
) -> list[Case]:
    """Return the cases of the full table, or a selection by scenes, profiles, rings, seeds and methods.

    Clean pictures of phantoms (solids and printed roots) do not depend on a seed, so that they occur once. The thesis's
    method is measured for phantoms and for clean pictures.

    Parameters
    ----------
    scenes, profiles : sequence of str
        Patterns of names; matching cases are selected.
    rings : sequence of int
        Numbers of rings.
    seeds : sequence of int
        Random seeds of plants and disturbances.
    methods : sequence of Method
        Selected methods.

    Returns
    -------
    list of Case
        The cases, in a fixed order.

    Raises
    ------
    UserError
        If no case matches.
    """
    rows: dict[str, dict[str, tuple[Literal[1, 2], ...]]] = {}
    for pattern, row in LADDER.items():
        rows |= {name: row for name, _ in library() if fnmatchcase(name, pattern) and name not in rows}
    cases = []
    for seed, (name, row) in product(seeds, rows.items()):
        for profile, possible in row.items():
            is_phantom = name in PHANTOMS
            if profile not in profiles or (is_phantom and profile == "clean" and seed != seeds[0]):
                continue
            for count in (one for one in possible if one in rings):
                pictures = Pictures(scene=name, profile=profile, rings=count, seed=seed)
                measured = [method for method in methods if method == "coverage" or is_phantom or profile == "clean"]
                sizes = CAMERA_SIZES.get(name, ()) if (count, profile, seed) == (2, "clean", 0) and "coverage" in methods else ()
                cases += [Case(pictures=pictures, method=method) for method in measured]
                cases += [Case(pictures=replace(pictures, image_wh=size)) for size in sizes]
    return _some(cases, scenes, profiles)

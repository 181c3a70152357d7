"""Definition of the benchmarks and their cases.

The name of a benchmark ends with a version. If cases are modified, the version is increased, so that results under one
name remain comparable.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.files import load_profile, load_scene
from rhizotwin.scenes.model import Ring, Scene
from rhizotwin.scenes.name_suggestion import most_similar
from rhizotwin.scenes.specimens import GrownSpecimen

HELD_BACK = 1000
"""Smallest random seed reserved for benchmarks. Methods must not be tuned on scans with this or a larger seed."""
PLANT_SEEDS_APART = 1_000_003
"""Factor by which the seed of a case is multiplied before it is added to the plant's seed in the scene. A case with
seed 0 shows the plant of the library. The factor is a large prime, so that no other case shows a plant of the
library."""
HIGH_RING = Ring(height_mm=10.0, tilt_deg=8.0, first_deg=4.5)
"""Second ring in scans of plants.

In the first ring at -42 mm, the topmost 2.4 mm of a plant (8 % of the volume of radish_day05a) appear in front of the
dark net pot. The second ring at 10 mm sees them in front of the backlight, which removes half of the hull's artefacts.
"""


def rendered_scene(scene: Scene, profile: str, *, rings: int, views: int, image_wh: tuple[int, int], seed: int) -> Scene:
    """Return the scene of a benchmark case.

    It is a copy of a library scene with a different plant, number of views and simulated imperfections.

    Parameters
    ----------
    scene : Scene
        Library scene.
    profile : str
        Name of the profile of simulated imperfections.
    rings : int
        1: rings of the scene; 2: first ring of the scene, and `HIGH_RING` at the same distance.
    views : int
        Number of views per ring.
    image_wh : tuple of int
        Width and height of the pictures, px.
    seed : int
        Seed of the simulated plant, see `PLANT_SEEDS_APART`; ignored for other specimens.
    """
    first = scene.plan.rings[0]
    chosen = scene.plan.rings if rings == 1 else (first, replace(HIGH_RING, distance_mm=first.distance_mm))
    specimen = scene.specimen
    if isinstance(specimen, GrownSpecimen):
        specimen = replace(specimen, seed=specimen.seed + PLANT_SEEDS_APART * seed)
    return replace(
        scene,
        camera=scene.camera if scene.camera.image_wh == image_wh else scene.camera.resized(image_wh),
        plan=replace(scene.plan, rings=tuple(replace(ring, views=views) for ring in chosen)),
        specimen=specimen,
        disturbances=load_profile(profile),
    )


@dataclass(frozen=True, kw_only=True)
class Case:
    """Simulated scan of a benchmark."""

    name: str
    scene: str
    profile: str
    views: int
    """Number of views per ring."""
    image_wh: tuple[int, int]
    rings: int = 1
    seed: int = HELD_BACK
    """Random seed of the plant and of all simulated imperfections."""

    def rendered_scene(self) -> Scene:
        """Return the scene to render for this case."""
        scene = rendered_scene(
            load_scene(self.scene), self.profile, rings=self.rings, views=self.views, image_wh=self.image_wh, seed=self.seed
        )
        return replace(scene, name=self.name, description="")


@dataclass(frozen=True, kw_only=True)
class Benchmark:
    """Named set of cases on which methods are compared."""

    name: str
    description: str
    cases: tuple[Case, ...]

    def chosen(self, names: tuple[str, ...]) -> Benchmark:
        """Return a copy of the benchmark that contains only the cases in ``names``, each once.

        If ``names`` is empty, the copy contains all cases.

        Raises
        ------
        UserError
            If a case is unknown.
        """
        known = {case.name: case for case in self.cases}
        for name in names:
            if name not in known:
                raise UserError(f"the benchmark {self.name} has no case {name!r}; choose from {', '.join(known)}")
        return replace(self, cases=tuple(known[name] for name in dict.fromkeys(names)) or self.cases)


def _plant(name: str, scene: str, profile: str, *, seed: int = HELD_BACK) -> Case:
    return Case(name=name, scene=scene, profile=profile, views=40, rings=2, image_wh=(800, 600), seed=seed)


def _small(name: str, scene: str, profile: str, *, views: int = 24) -> Case:
    return Case(name=name, scene=scene, profile=profile, views=views, image_wh=(400, 300))


BENCHMARKS = {
    one.name: one
    for one in (
        Benchmark(
            name="quick-1",
            description="a sphere, a printed root without and with rig errors, and a bean; small pictures, which take a few minutes",
            cases=(
                _small("ball", "sphere_20mm", "clean", views=16),
                _small("print", "printed_8ml", "clean"),
                _small("print-bench", "printed_8ml", "bench"),
                _small("bean", "bean", "clean", views=40),
            ),
        ),
        Benchmark(
            name="roots-1",
            description="ten root systems of eight kinds on a well-built rig; 40 pictures of 800x600 from each of two camera heights",
            cases=(
                _plant("radish-05", "radish_day05a", "bench"),
                _plant("radish-15", "radish_day15b", "bench"),
                _plant("radish-30", "radish_day30c", "bench"),
                _plant("bean", "bean", "bench"),
                _plant("maize", "maize", "bench"),
                _plant("wheat", "wheat", "bench"),
                _plant("lettuce", "lettuce", "bench"),
                _plant("carrot", "carrot", "bench"),
                _plant("bulb", "bulb", "bench"),
                _plant("radish-swollen", "radish_swollen", "bench"),
            ),
        ),
        Benchmark(
            name="hard-1",
            description="difficulties of real scans: translucent roots with root hairs, sway, dirt, bubbles, JPEG artefacts, few pictures",
            cases=(
                _plant("radish-harsh", "radish_day15b", "harsh", seed=HELD_BACK + 1),
                _plant("radish-real", "radish_day15b", "real", seed=HELD_BACK + 2),
                _plant("bean-real", "bean", "real", seed=HELD_BACK + 3),
                _plant("lettuce-real", "lettuce", "real", seed=HELD_BACK + 4),
                _plant("maize-camera", "maize", "camera", seed=HELD_BACK + 5),
                _small("print-few", "printed_8ml", "real", views=12),
                _small("ball-few", "sphere_20mm", "harsh", views=12),
            ),
        ),
    )
}


def find(name: str) -> Benchmark:
    """Return the benchmark with the given name.

    Raises
    ------
    UserError
        If the name is unknown.
    """
    if name not in BENCHMARKS:
        near = most_similar(name, list(BENCHMARKS))
        raise UserError(
            f"the benchmark {name!r} is unknown{f'; did you mean {near}?' if near else ''}; choose from {', '.join(BENCHMARKS)}"
        )
    return BENCHMARKS[name]

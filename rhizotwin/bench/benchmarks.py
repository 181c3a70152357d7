"""The benchmarks and their cases.

A name ends with a version. Modified cases get a new name, so that numbers under one name remain comparable.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.files import load_profile, load_scene
from rhizotwin.scenes.model import Ring, Scene
from rhizotwin.scenes.name_suggestion import most_similar
from rhizotwin.scenes.specimens import GrownSpecimen

HELD_BACK = 1000
"""First seed reserved for benchmarks; methods must not be tuned on these seeds."""
PLANT_SEEDS_APART = 1_000_003
"""Seed s grows the plant with the scene's own seed + s times this prime: 0 is the plant of the library, and no other
seed coincides with one of its plants."""
HIGH_RING = Ring(height_mm=10.0, tilt_deg=8.0, first_deg=4.5)
"""Height and tilt of the second ring of a plant. From -42 mm, its topmost 2.4 mm (8 % of the volume of radish_day05a)
are seen in front of the dark net pot; from 10 mm they are seen in front of the backlight, and half of the hull's
artefacts disappear."""


def rendered_scene(scene: Scene, profile: str, *, rings: int, views: int, image_wh: tuple[int, int], seed: int) -> Scene:
    """Return a scene with another plant, other views and the disturbances of a profile.

    Parameters
    ----------
    scene : Scene
        Scene of the library.
    profile : str
        Name of the profile.
    rings : int
        1: the capture plan of the scene; 2: its first ring, and `HIGH_RING` at the same distance.
    views : int
        Number of views per ring.
    image_wh : tuple of int
        Picture size in px.
    seed : int
        Seed of the plant, if the specimen is grown.
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
    """One scan of a benchmark."""

    name: str
    scene: str
    profile: str
    views: int
    """Number of views per ring."""
    image_wh: tuple[int, int]
    rings: int = 1
    seed: int = HELD_BACK
    """Seed of the plant and of all disturbances."""

    def rendered_scene(self) -> Scene:
        """Return the scene with this plant, these views and the disturbances of the profile."""
        scene = rendered_scene(
            load_scene(self.scene), self.profile, rings=self.rings, views=self.views, image_wh=self.image_wh, seed=self.seed
        )
        return replace(scene, name=self.name, description="")


@dataclass(frozen=True, kw_only=True)
class Benchmark:
    """Named set of cases."""

    name: str
    description: str
    cases: tuple[Case, ...]

    def chosen(self, names: tuple[str, ...]) -> Benchmark:
        """Return the benchmark with the given cases only, or all without names; raise UserError for an unknown name."""
        known = {case.name: case for case in self.cases}
        for name in names:
            if name not in known:
                raise UserError(f"{self.name} has no case {name!r}; its cases are {', '.join(known)}")
        return replace(self, cases=tuple(known[name] for name in names) or self.cases)


def _plant(name: str, scene: str, profile: str, *, seed: int = HELD_BACK) -> Case:
    return Case(name=name, scene=scene, profile=profile, views=40, rings=2, image_wh=(800, 600), seed=seed)


def _small(name: str, scene: str, profile: str, *, views: int = 24) -> Case:
    return Case(name=name, scene=scene, profile=profile, views=views, image_wh=(400, 300))


BENCHMARKS = {
    one.name: one
    for one in (
        Benchmark(
            name="quick-1",
            description="a sphere, a printed root without and with rig errors, and a bean: small pictures, a few minutes",
            cases=(
                _small("ball", "sphere_20mm", "clean", views=16),
                _small("print", "printed_8ml", "clean"),
                _small("print-bench", "printed_8ml", "bench"),
                _small("bean", "bean", "clean", views=40),
            ),
        ),
        Benchmark(
            name="roots-1",
            description="ten root systems of eight kinds on a well-built rig, two rings of 40 pictures of 800x600",
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
    """Return a benchmark by name; raise UserError if it is unknown."""
    if name not in BENCHMARKS:
        near = most_similar(name, list(BENCHMARKS))
        raise UserError(f"unknown benchmark {name!r}{f'; did you mean {near}?' if near else ''}; available: {', '.join(BENCHMARKS)}")
    return BENCHMARKS[name]

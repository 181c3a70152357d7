"""Cache of rendered datasets: one folder per key, which contains everything that determines the pictures.

A change of the renderer's sources, the scene, profile, seed or Mitsuba's version results in another folder. Sources
that only affect the truth (`TRUTH_ONLY`) are not in the key: after a change, the truth beside cached pictures is
written again.
"""

import math
from pathlib import Path
from typing import Any, Protocol

from benchmarks import cache
from rhizotwin.scenes import atomic
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.files import scene_to_dict
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.provenance import versions
from rhizotwin.scenes.truth import load_truth, save_truth
from rhizotwin.stored import sources

PICTURES = ("rhizotwin.sim.simulate",)
TRUTH_ONLY = frozenset({"rhizotwin.scenes.traits", "rhizotwin.scenes.truth", "rhizotwin.sim.truth"})
"""Modules that only affect the recorded truth, which `make` renews automatically."""
TRUTH = ("rhizotwin.sim.truth",)

SAME_VOLUME = 1e-9
"""Maximum relative difference of two volumes of the same solid, whose sums may be evaluated in another order."""


class Pictures(Protocol):
    """A dataset to render: `benchmarks.cases.Pictures`, `benchmarks.random_scans.RandomScan`."""

    @property
    def profile(self) -> str:
        """Name of the disturbances' profile."""

    @property
    def seed(self) -> int:
        """Random seed of the rendering."""

    def scene_to_render(self) -> Scene:
        """Return the scene."""


def settings(pictures: Pictures) -> dict[str, Any]:
    """Return everything except the sources that determines a dataset, as a JSON object."""
    return {
        # does not affect any picture
        "scene": {key: value for key, value in scene_to_dict(pictures.scene_to_render()).items() if key != "subject"},
        "profile": pictures.profile,
        "seed": pictures.seed,
        "fidelity": "backlit",
        "mitsuba": versions(("mitsuba",))["mitsuba"],
    }


def place(pictures: Pictures) -> Path:
    """Return the path of a dataset in the cache, whether it exists or not."""
    code = sources.digest(PICTURES, without=TRUTH_ONLY)
    return cache.folder() / "datasets" / cache.key(settings(pictures), sources=code)


def is_ready(pictures: Pictures) -> bool:
    """Return whether the cache contains the dataset, with up-to-date truth."""
    folder = place(pictures)
    return folder.is_dir() and _written_by(folder) == sources.digest(TRUTH)


def make(pictures: Pictures) -> Path:
    """Return the folder of a dataset.

    It is rendered if it is missing in the cache (resuming an interrupted run), with its truth up to date.
    """
    from rhizotwin.sim.simulate import simulate

    folder = place(pictures)
    if not folder.is_dir():
        unfinished = folder.with_suffix(".part")
        simulate(pictures.scene_to_render(), unfinished, profile_name=pictures.profile, seed=pictures.seed)
        unfinished.rename(folder)
        sign(folder)
    elif not is_ready(pictures):
        renew_truth(folder, pictures)
    return folder


def renew_truth(folder: Path, pictures: Pictures) -> None:
    """Write the truth of cached pictures (except its masks, which are pictures) with the present sources.

    Raises
    ------
    UserError
        If the specimen differs from the one that was rendered.
    """
    from rhizotwin.sim.specimen import build_specimen
    from rhizotwin.sim.truth import build_truth, write_specimen
    from rhizotwin.sim.world import draw_world

    scene = pictures.scene_to_render()
    solid = build_specimen(scene)
    before_mm3 = load_truth(folder).volume_mm3
    if not math.isclose(before_mm3, solid.volume_mm3, rel_tol=SAME_VOLUME):
        raise UserError(f"{folder} shows a specimen of {before_mm3} mm3, not of {solid.volume_mm3} mm3; delete it, to be rendered again.")
    cameras = draw_world(scene, seed=pictures.seed)
    taken = zip((frame.file for frame in load_dataset(folder).frames), cameras.cameras, strict=True)
    write_specimen(folder, solid)
    save_truth(folder, build_truth(cameras, solid, taken))
    sign(folder)


def _signature(folder: Path) -> Path:
    return folder.with_suffix(".truth")


def _written_by(folder: Path) -> str | None:
    path = _signature(folder)
    return path.read_text(encoding="utf-8").strip() if path.is_file() else None


def sign(folder: Path) -> None:
    """Record beside a dataset the sources that wrote its truth."""
    atomic.write_text(_signature(folder), sources.digest(TRUTH) + "\n")

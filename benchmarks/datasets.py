"""Rendered datasets, kept between runs: a folder a key, and the key is all that decides the pictures.

A changed source of the renderer or another scene, profile, seed or version of Mitsuba is another folder. Sources that
only write what is known into the truth (`TRUTH_ONLY`) are not in the key: where they changed, the truth beside kept
pictures is written anew.
"""

import math
from pathlib import Path
from typing import Any, Protocol

from benchmarks import cache
from rhizotwin import sources
from rhizotwin.scenes import atomic
from rhizotwin.scenes.dataset import load_dataset
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.files import scene_to_dict
from rhizotwin.scenes.model import Scene
from rhizotwin.scenes.provenance import versions
from rhizotwin.scenes.truth import load_truth, save_truth

PICTURES = ("rhizotwin.sim.simulate",)
TRUTH_ONLY = frozenset({"rhizotwin.scenes.traits", "rhizotwin.scenes.truth", "rhizotwin.sim.truth"})
"""Modules that only write what is known of the specimen beside the pictures: `make` renews that by itself."""
TRUTH = ("rhizotwin.sim.truth",)

SAME_VOLUME = 1e-9
"""Relative difference of two volumes of one solid: its sums may be taken in another order."""


class Pictures(Protocol):
    """A dataset to render: `benchmarks.cases.Pictures`, `benchmarks.mixtures.Mixture`."""

    @property
    def profile(self) -> str:
        """Where the disturbances come from."""

    @property
    def seed(self) -> int:
        """Of all that the renderer draws."""

    def scene_to_render(self) -> Scene:
        """Return the scene."""


def settings(pictures: Pictures) -> dict[str, Any]:
    """Return all that decides what a dataset looks like, besides the sources, as JSON values."""
    return {
        # changes no picture
        "scene": {key: value for key, value in scene_to_dict(pictures.scene_to_render()).items() if key != "subject"},
        "profile": pictures.profile,
        "seed": pictures.seed,
        "fidelity": "backlit",
        "mitsuba": versions(("mitsuba",))["mitsuba"],
    }


def place(pictures: Pictures) -> Path:
    """Return the folder in the cache where a dataset lies or is to lie."""
    code = sources.digest(PICTURES, without=TRUTH_ONLY)
    return cache.folder() / "datasets" / cache.key(settings(pictures), sources=code)


def is_ready(pictures: Pictures) -> bool:
    """Tell whether the cache holds the dataset, with its truth as the sources write it now."""
    folder = place(pictures)
    return folder.is_dir() and _written_by(folder) == sources.digest(TRUTH)


def make(pictures: Pictures) -> Path:
    """Return the folder of a dataset.

    Rendered where the cache lacks it (resuming where it was cut off), its truth up to date.
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
    """Write the truth of kept pictures (its masks apart, which are pictures) as the sources write it now.

    Raises
    ------
    UserError
        Where the specimen is not the one that was rendered.
    """
    from rhizotwin.sim.specimen import build_specimen
    from rhizotwin.sim.truth import truth_of, write_specimen
    from rhizotwin.sim.world import draw_world

    scene = pictures.scene_to_render()
    solid = build_specimen(scene)
    before_mm3 = load_truth(folder).volume_mm3
    if not math.isclose(before_mm3, solid.volume_mm3, rel_tol=SAME_VOLUME):
        raise UserError(f"{folder} shows a specimen of {before_mm3} mm3, not of {solid.volume_mm3} mm3; delete it, to be rendered again.")
    cameras = draw_world(scene, seed=pictures.seed)
    taken = zip((frame.file for frame in load_dataset(folder).frames), cameras.cameras, strict=True)
    write_specimen(folder, solid)
    save_truth(folder, truth_of(cameras, solid, taken))
    sign(folder)


def _signature(folder: Path) -> Path:
    return folder.with_suffix(".truth")


def _written_by(folder: Path) -> str | None:
    path = _signature(folder)
    return path.read_text(encoding="utf-8").strip() if path.is_file() else None


def sign(folder: Path) -> None:
    """Note beside a dataset which sources wrote its truth."""
    atomic.write_text(_signature(folder), sources.digest(TRUTH) + "\n")

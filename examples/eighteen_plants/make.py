"""Simulate and reconstruct the scans of the example of eighteen plants, and pack what the analyses need.

The plants are those of Kliman's thesis (2022, table A.1): three were harvested on each of the days 5, 10, ..., 30. Here
each plant is also scanned on earlier days. An interrupted run continues with the same command.

Examples
--------
python examples/eighteen_plants/make.py my_folder
"""

import io
import json
import subprocess
import sys
import tarfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from rhizotwin.experiment.thesis_tables import EXAMPLE, shipped
from rhizotwin.scenes import atomic, rsml, series
from rhizotwin.scenes.files import load_profile, load_scene
from rhizotwin.scenes.model import Ring, Scene
from rhizotwin.scenes.rsml import Root
from rhizotwin.scenes.rsml_reader import read_rsml
from rhizotwin.sim.growth import grow
from rhizotwin.steps import front_door

HARVEST = {plant: 5 * ((plant + 2) // 3) for plant in range(1, 19)}
"""Day of the harvest of each plant, as in table A.1."""
DENSE = {10, 13, 18}
"""Plants whose roots overlap so much at the harvest that the length is not reliable: not scanned on that day."""
LIVING = ((18, 5), (13, 5), (10, 5), (17, 10), (8, 10), (9, 10), (14, 10), (12, 10), (7, 10), (16, 10))
"""Plants that are scanned while they live, and day of the scan."""
RINGS = {1: (20, 20), 5: (40, 40)}
"""Pictures of each ring for plants whose volume or length is not reliable in a ring of 40 at the harvest."""
IMAGE_WH = (800, 600)
"""Size of the pictures. In 32 pictures of 600x450, radishes 1, 17 and 18 of 5 days were not reliable."""
PROFILE, SEED = "clean", 0
HIGH_RING = Ring(height_mm=10.0, tilt_deg=8.0, first_deg=4.5)
"""Second ring, from which the top of the roots appears in front of the panel."""

THIN_MM = 0.02
"""Largest error, mm, of the packed centre lines and diameters, which makes roots 0.01 % shorter. Points that are not
needed for it are left out, because the package must remain small."""


def scans() -> Iterator[tuple[int, int]]:
    """Yield plant and day of each scan."""
    yield from ((plant, harvest) for plant, harvest in HARVEST.items() if plant not in DENSE)
    yield from LIVING


def scene_of(plant: int, day: int) -> Scene:
    """Return the scene of a plant of the library on a day."""
    library = load_scene(f"radish_day{HARVEST[plant]:02}{'abc'[(plant - 1) % 3]}")
    views = RINGS.get(plant, (40,)) if day == HARVEST[plant] else (40, 40) if plant in DENSE else (20, 20)
    first = library.plan.rings[0]
    rings = (first, replace(HIGH_RING, distance_mm=first.distance_mm))
    scene = series.at_day(library, float(day), grow=grow)
    return replace(
        scene,
        name=f"radish_{plant:02}_day_{day:02}",
        description="",
        camera=library.camera.resized(IMAGE_WH),
        plan=replace(library.plan, rings=tuple(replace(ring, views=own) for ring, own in zip(rings, views, strict=False))),
        disturbances=load_profile(PROFILE),
    )


def make(folder: Path) -> None:
    """Make the scans and results that are missing in a folder."""
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=True).stdout.strip()
    for plant, day in scans():
        scene = scene_of(plant, day)
        dataset, result = folder / "scans" / scene.name, folder / "results" / scene.name
        if (result / "made.json").is_file():
            continue
        front_door.simulate(scene, dataset, seed=SEED, device="cpu")
        front_door.reconstruct(dataset, device="cpu").save(result)
        rings = [ring.views for ring in scene.plan.rings]
        atomic.write_json(result / "made.json", {"profile": PROFILE, "seed": SEED, "views": rings, "commit": commit})


def thin(root: Root) -> Root:
    """Return a root with the points that are needed for `THIN_MM` (Douglas and Peucker 1973, Cartographica 10:112)."""
    values = np.column_stack([root.points_mm, root.diameters_mm])
    kept, pieces = {0, len(values) - 1}, [(0, len(values) - 1)]
    while pieces:
        begin, end = pieces.pop()
        chord = values[end] - values[begin]
        inside = values[begin + 1 : end] - values[begin]
        share = np.clip(inside[:, :3] @ chord[:3] / max(float(chord[:3] @ chord[:3]), 1e-12), 0.0, 1.0)
        away = inside - share[:, None] * chord
        error = np.maximum(np.linalg.norm(away[:, :3], axis=1), np.abs(away[:, 3]))
        if len(error) and error.max() > THIN_MM:
            middle = begin + 1 + int(error.argmax())
            kept.add(middle)
            pieces += [(begin, middle), (middle, end)]
    short = values[sorted(kept)].round(2)
    return replace(root, points_mm=short[:, :3], diameters_mm=short[:, 3], diameter_sigma_mm=None)


def pack(folder: Path) -> None:
    """Write what the analyses need of the results to the archive that is part of the package."""
    rows = ["scan,profile,seed,views,commit"]
    with tarfile.open(shipped(EXAMPLE), "w:xz", preset=9) as archive:
        for path in sorted((folder / "results").glob("*/made.json")):
            result, made = path.parent, json.loads(path.read_text(encoding="utf-8"))
            rows.append(f"{result.name},{made['profile']},{made['seed']},{'+'.join(map(str, made['views']))},{made['commit']}")
            roots = folder / "packed" / f"{result.name}.rsml"
            rsml.write_rsml(roots, [thin(root) for root in read_rsml(result / "roots.rsml")])
            summary = json.loads((result / "result.json").read_text(encoding="utf-8"))
            _add(archive, f"results/{result.name}/roots.rsml", roots.read_bytes())
            _add(archive, f"results/{result.name}/result.json", json.dumps(summary | {"dataset": result.name, "views": []}).encode())
        _add(archive, "scans.csv", ("\n".join(rows) + "\n").encode())


def _add(archive: tarfile.TarFile, name: str, content: bytes) -> None:
    entry = tarfile.TarInfo(name)
    entry.size = len(content)
    archive.addfile(entry, io.BytesIO(content))


if __name__ == "__main__":
    make(Path(sys.argv[1]))
    pack(Path(sys.argv[1]))

"""One timed job, run by `benchmarks.speed` in a process of its own; the last line of output is its numbers as JSON."""

import argparse
import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal


def render(fidelity: Literal["backlit", "path"], working: Path) -> dict[str, Any]:
    """Return the seconds of the first view (scene and kernels made) and of each one more, of `printed_8ml` at 800x600."""
    from benchmarks.cases import Pictures
    from scenes.model import CapturePlan
    from sim.simulate import simulate

    walls = []
    for views in (1, 3):
        scene = Pictures(scene="printed_8ml").scene_to_render()
        scene = replace(scene, plan=CapturePlan(rings=(replace(scene.plan.rings[0], views=views),)))
        began = time.perf_counter()
        simulate(scene, working / str(views), profile_name="clean", seed=0, fidelity=fidelity, progress=False)
        walls.append(time.perf_counter() - began)
    return {"first_view": walls[0], "per_view": (walls[1] - walls[0]) / 2.0}


def reconstruct(dataset_folder: Path, voxel_mm: float, working: Path) -> dict[str, Any]:
    """Return the seconds of a reconstruction by stage."""
    from recon import pipeline
    from recon.result_files import read_summary

    pipeline.reconstruct(dataset_folder, working / "result", voxel_mm=voxel_mm, progress=False)
    return {"stages": read_summary(working / "result")["timings_s"]}


def main() -> int:
    """Run the job that the arguments name."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="auto")
    parser.add_argument("--working", type=Path, required=True)
    jobs = parser.add_subparsers(dest="job", required=True)
    rendering = jobs.add_parser("render")
    rendering.add_argument("fidelity", choices=["backlit", "path"])
    reconstructing = jobs.add_parser("reconstruct")
    reconstructing.add_argument("dataset", type=Path)
    reconstructing.add_argument("voxel_mm", type=float)
    given = parser.parse_args()

    from rhizotwin import engine
    from scenes.provenance import peak_memory_mib

    engine.start(given.device)
    found = render(given.fidelity, given.working) if given.job == "render" else reconstruct(given.dataset, given.voxel_mm, given.working)
    found["peak_memory"] = peak_memory_mib()
    sys.stdout.write("\n" + json.dumps(found) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())

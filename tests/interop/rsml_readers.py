"""Check that CPlantBox and OpenAlea read RSML files as they were written; neither is installed in CI."""

import json
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np

PACKAGES = ("cplantbox==2.1.1", "pandas", "path", "scipy", "matplotlib", "xlsxwriter")
SNAPSHOTS = {
    "https://github.com/openalea/RSML": "7ffc35b0acac4eb30a9f7568bbf4d666418d371a",
    "https://github.com/openalea/mtg": "34e15035db740c3ed03d3a0c94b87391859f8d1b",
}
"""Sources of OpenAlea, which has no release on PyPI, and their commits. Git's setting url.*.insteadOf selects a local copy."""


def check(folder: Path) -> dict[str, tuple[float, float]]:
    """Write roots of three orders to a folder, and compare what both programs read with what was written.

    The programs are installed into the folder. The result contains each number by the program and ours.
    """
    from rhizotwin.scenes import rsml
    from tests.roots import straight

    first = {"mm": (0.9, 0.3), "count": 9, "order": 1, "parent": 0}
    roots = (
        straight((0.0, 0.0, -12.0), (0.0, 0.0, -92.0), (1.2, 0.4), count=9),
        straight((0.0, 0.0, -32.0), (24.0, 0.0, -40.0), **first, tip_seen=False),
        straight((12.0, 0.0, -36.0), (12.0, 18.0, -44.0), (0.6, 0.2), count=9, order=2, parent=1),
        straight((0.0, 0.0, -52.0), (-24.0, 8.0, -60.0), **first),
    )
    rsml.write_rsml(folder / "roots.rsml", roots)
    ours = {
        "roots": len(roots),
        "length mm": rsml.length_mm(roots),
        "depth mm": 92.0,
        "orders": sum(one.order for one in roots),
        "attached at": 2 + 4 + 4,  # indices of the parents' points
        "hidden tips": sum(not one.tip_seen for one in roots),
        "mean diameter mm": float(np.mean([one.diameters_mm for one in roots])),
        "joined length mm": rsml.length_mm(roots),
    }
    read = _read_apart(folder)
    return {f"{program}, {name}": (read[program].get(name, np.nan), value) for program in read for name, value in ours.items()}


def _read_apart(folder: Path) -> dict[str, dict[str, float]]:
    """Install both programs into a folder, and return what they read."""
    from tests.interop.environment import fetch, install, run  # the programs' environment runs this file without it

    python = install(folder / "venv", *PACKAGES)
    for url, commit in SNAPSHOTS.items():
        copy = folder / Path(url).name
        fetch("git", "clone", "--quiet", "--no-checkout", url, copy)
        fetch("git", "-C", copy, "checkout", "--quiet", commit, "--", "src")
    sources = os.pathsep.join(str(folder / Path(url).name / "src") for url in SNAPSHOTS)
    told = run(python, __file__, folder / "roots.rsml", folder=folder, variables={"PYTHONPATH": sources, "MPLBACKEND": "agg"})
    found: dict[str, dict[str, float]] = json.loads(told.splitlines()[-1])
    return found


def _of_cplantbox(file: str) -> dict[str, float]:
    from plantbox.rsml import rsml_reader

    lines, properties, functions, metadata = rsml_reader.read_rsml(file)
    nodes, segments = rsml_reader.get_segments(lines, properties)
    mm = 10.0 * metadata.scale_to_cm  # the points stay in the unit of the file
    return {
        "roots": len(lines),
        "length mm": mm * sum(_length(line) for line in lines),
        "depth mm": -mm * min(point[2] for line in lines for point in line),
        "orders": sum(rsml_reader.get_root_orders(properties)),
        "attached at": sum(properties["parent-node"]),
        "hidden tips": len(lines) - sum(properties["tip-seen"]),
        "mean diameter mm": float(np.mean(functions["diameter"])),
        "joined length mm": mm * float(np.linalg.norm(nodes[segments[:, 1]] - nodes[segments[:, 0]], axis=1).sum()),
    }


def _of_openalea(file: str) -> dict[str, float]:
    from openalea.rsml.continuous import continuous_to_discrete
    from openalea.rsml.io import rsml2mtg

    graph = rsml2mtg(file)
    read: dict[str, Any] = graph.properties()
    axes = list(read["geometry"])
    numbers = {
        "roots": len(axes),
        "length mm": sum(_length(line) for line in read["geometry"].values()),
        "depth mm": -min(point[2] for line in read["geometry"].values() for point in line),
        "orders": sum(graph.order(axis) for axis in axes),
        "attached at": sum(read["parent-node"].values()),
        "hidden tips": len(axes) - sum(read["tip-seen"].values()),
        "mean diameter mm": float(np.mean(list(read["diameter"].values()))),
    }
    secondary = [axis for axis in axes if graph.order(axis) > 1]  # it attaches them one point too far
    joined_mm = sum(_length(read["geometry"][axis]) for axis in secondary)
    for axis in axes:
        if graph.parent(axis) is None:
            del read["parent-node"][axis]  # docs/datasets.md: the conversion needs no parent-node of taproots
    continuous_to_discrete(graph)
    place = read["position"]
    inner = [(one, graph.parent(one)) for one in place if graph.complex(one) not in secondary]
    joined_mm += sum(_length([place[one], place[above]]) for one, above in inner if above is not None)
    return {**numbers, "joined length mm": joined_mm}


def _length(points: Any) -> float:
    return float(np.linalg.norm(np.diff(np.array(points), axis=0), axis=1).sum())


if __name__ == "__main__":
    sys.stdout.write(json.dumps({"CPlantBox": _of_cplantbox(sys.argv[1]), "OpenAlea": _of_openalea(sys.argv[1])}) + "\n")

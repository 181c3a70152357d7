"""Scoring of the output folder of a method, in which files are recognised by their names.

    shape.{ply,stl,obj,glb}, voxels.{nrrd,npz}, points.{ply,xyz}, roots.rsml, traits.csv

All files are optional and scored separately. If a file cannot be read, the reason is reported. If the folder is a
result of rhizotwin, ``result.json`` states whether the volume is reliable.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.folders import contents
from rhizotwin.scoring import foreign_files, score_file
from rhizotwin.scoring.score_file import FileScore
from rhizotwin.stored.result_files import read_summary

Score = Callable[[Path, Path], FileScore]
KINDS: dict[str, tuple[tuple[str, ...], Score]] = {
    "mesh": (tuple(f"shape{suffix}" for suffix in foreign_files.MESHES), score_file.score_mesh),
    "voxels": (tuple(f"voxels{suffix}" for suffix in foreign_files.VOXELS), score_file.score_voxels),
    "points": (tuple(f"points{suffix}" for suffix in foreign_files.POINTS), score_file.score_points),
    "rsml": (("roots.rsml",), score_file.score_rsml),
    "traits": (("traits.csv",), score_file.score_traits),
}


def score_outputs(output: Path, dataset: Path) -> tuple[dict[str, Any], list[str]]:
    """Score all files in the output folder of a method whose names are known.

    Parameters
    ----------
    output : path
        Output folder of the method.
    dataset : path
        Simulated dataset with ground truth.

    Returns
    -------
    scores : dict
        Scores by type of file (mesh, voxels, points, rsml, traits) as JSON values, and ``trusted`` for a result of
        rhizotwin.
    sentences : list of str
        Reasons why files could not be scored.
    """
    names = contents(output) if output.is_dir() else []
    scores = dict[str, Any]()
    sentences = list[str]()
    for kind, (known, score) in KINDS.items():
        file = next((name for name in known if name in names), None)
        if file is None:
            continue
        try:
            scores[kind] = score(output / file, dataset).to_dict() | {"file": file}
        except UserError as error:
            sentences.append(str(error))
        except Exception as error:  # noqa: BLE001 - an unexpected file must not prevent the scoring of other files
            sentences.append(f"{file} could not be scored ({type(error).__name__}: {error})")
    if "result.json" in names:
        try:
            scores["trusted"] = bool(read_summary(output)["volume_trusted"])
        except UserError as error:
            sentences.append(str(error))
    return scores, sentences

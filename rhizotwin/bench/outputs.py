"""What a method left in its output folder, scored: the files are found by their names.

    shape.{ply,stl,obj,glb}, voxels.{nrrd,npz}, points.{ply,xyz}, roots.rsml, traits.csv

Any of them may be there, each is scored by itself; what cannot be read is said and the others are scored. A result of
rhizotwin has such files; its ``result.json`` says beside whether the volume is trusted.
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
    """Score every file in a method's output that has a known name.

    Parameters
    ----------
    output : path
        What the method wrote.
    dataset : path
        The simulated dataset with its truth.

    Returns
    -------
    scores : dict
        By kind: mesh, voxels, points, rsml, traits, as JSON values; ``trusted`` where a result says it.
    sentences : list of str
        Why a file could not be scored.
    """
    names, scores, sentences = contents(output) if output.is_dir() else [], dict[str, Any](), list[str]()
    for kind, (known, score) in KINDS.items():
        file = next((name for name in known if name in names), None)
        if file is None:
            continue
        try:
            scores[kind] = score(output / file, dataset).to_dict() | {"file": file}
        except UserError as error:
            sentences.append(str(error))
        except Exception as error:  # noqa: BLE001 - a stranger's file must not end the others
            sentences.append(f"{file} could not be scored ({type(error).__name__}: {error})")
    if "result.json" in names:
        try:
            scores["trusted"] = bool(read_summary(output)["volume_trusted"])
        except UserError as error:
            sentences.append(str(error))
    return scores, sentences

"""Steps that several commands take: the engine started, a dataset reconstructed and drawn."""

import gc
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from rhizotwin import engine
from rhizotwin.arguments import Page, Progress
from rhizotwin.front_door import Method, reconstruct
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.folders import contents, new_folder, recover

if TYPE_CHECKING:
    from rhizotwin.recon.settings import PictureSettings, Settings
    from rhizotwin.scenes.model import Scene

SHARES = {
    "read": 0.1,
    "markers": 5.0,
    "poses": 1.5,
    "canister": 0.1,
    "background": 1.8,
    "wall": 0.8,
    "silhouettes": 0.7,
    "outlines": 0.3,
    "carve": 3.6,
    "trim": 3.8,
    "search": 3.5,
    "density": 1.3,
    "trace": 0.1,
    "tubes": 1.1,
    "translucency": 3.8,
    "branches": 2.7,
    "residue": 3.7,
    "hairs": 0.8,
    "calibration": 0.6,
    "last tubes": 0.2,
    "unite": 0.4,
    "uncertainty": 0.3,
    "surface": 0.3,
    "pictures": 6.0,
}
"""Seconds that the stages of a reconstruction take (radish_day05b, 20 views of 400x300, 2 cores); they tell how far it
is."""


def start_engine(device: str, *, quiet: bool = False) -> None:
    """Choose what computes, and say what it is."""
    chosen = engine.start(device)
    gc.freeze()  # what is loaded stays: searches for cycles, of which a reconstruction makes forty, pass it by
    if not quiet:
        print(chosen)


def open_page(address: str, port: int, page: Page) -> None:
    """Print where a page is served, and open it in a browser unless that is not wanted."""
    print(address, flush=True)
    print(f"from another computer: ssh -L {port}:localhost:{port} THIS_COMPUTER, then the same address", flush=True)
    if not page.no_browser:
        webbrowser.open(address)


def refuse_place(output: Path, source: Path) -> None:
    """Recover the folder of a result that is to be written; refuse one in which something would be lost.

    Parameters
    ----------
    output : Path
        The result's folder.
    source : Path
        The dataset or result that it is made from.
    """
    from rhizotwin.stored.result_files import RESULT_NAMES

    recover(output)
    there = contents(output)
    if there and not (output / "result.json").is_file():
        raise UserError(f"{output} holds something that is no result; choose a new folder for the result")
    strange = [name for name in there if name not in RESULT_NAMES]
    if strange:
        raise UserError(f"{output} holds {strange[0]} beside an earlier result, which would be lost; move it away or choose a new folder")
    if output.resolve() == source.resolve() or output.resolve() in source.resolve().parents:
        raise UserError(f"the result would overwrite {source}, which it is made from; choose another folder for the result")


@contextmanager
def _old_left_alone() -> Iterator[None]:
    """Keep Python's search for cycles from looking at what was there before, such as all modules.

    A reconstruction searches some fifty times, to give memory back.
    """
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def settings_of(file: Path | None, *, voxel_mm: float | None = None, pictures: "PictureSettings | None" = None) -> "Settings":
    """Return the settings of a TOML file, or the defaults, with others that override them.

    Parameters
    ----------
    file : Path, optional
        TOML file, see `recon.settings`.
    voxel_mm : float, optional
        Edge of the smallest voxels.
    pictures : PictureSettings, optional
        Which pictures are left out, beside those of the file.

    Raises
    ------
    UserError
        If the file cannot be read or holds anything wrong.
    """
    from rhizotwin.recon.settings import Settings, load_settings

    chosen = Settings() if file is None else load_settings(file)
    chosen = chosen if voxel_mm is None else replace(chosen, voxel_mm=voxel_mm)
    return chosen if pictures is None else replace(chosen, pictures=chosen.pictures.joined(pictures))


def reconstruct_whole(
    dataset: Path,
    output: Path,
    *,
    settings: "Settings | None" = None,
    mass_g: float | None = None,
    keep_stages: bool = False,
    method: Method = "ours",
    progress: Progress = Progress(),
) -> list[Path]:
    """Reconstruct a dataset and draw its pictures; the result folder appears whole or not at all.

    Return the pictures' paths.

    Parameters
    ----------
    settings : Settings, optional
        As `settings_of` gives them.
    keep_stages : bool
        Keep what each stage made, in the folder ``stages`` of the result.
    method : str
        As in `front_door.reconstruct`.
    progress : Progress
        How much is told meanwhile.

    Raises
    ------
    UserError
        If the dataset cannot be used, or ``output`` holds something that is not a result.
    """
    refuse_place(output, dataset)
    from rhizotwin.report import page
    from rhizotwin.report.result_pictures import write_pictures
    from rhizotwin.scenes.dataset import load_dataset
    from rhizotwin.scoring.score import truth_mesh_path
    from rhizotwin.stored.result_files import RESULT_NAMES, read_mesh

    # once: what happens to the folder meanwhile does not change what the result was made from
    loaded = load_dataset(dataset)
    truth_mesh = truth_mesh_path(dataset) if (dataset / "truth" / "specimen.ply").is_file() else None
    if truth_mesh is not None:
        read_mesh(truth_mesh)  # a damaged one is named now, not after the work
    with new_folder(output, replaces=RESULT_NAMES) as building, _old_left_alone():
        with progress.bar(**SHARES) as monitor:
            kept = building / "stages" if keep_stages else None
            reconstruct(loaded, settings=settings, mass_g=mass_g, keep_stages=kept, method=method, monitor=monitor).save(building)
            with monitor.stage("pictures"):
                written = write_pictures(building, loaded, truth_mesh=truth_mesh)
                written.append(page.write(building, dataset=loaded))
        names = [path.relative_to(building) for path in written]
    return [output / name for name in names]


def print_marker_warnings(scene: "Scene") -> None:
    """Print which rings see too few markers to find their cameras."""
    from rhizotwin.scenes import plan

    for warning in plan.marker_warnings(scene):
        print(f"warning: {warning}")

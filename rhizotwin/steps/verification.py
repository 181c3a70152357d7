"""Python interface for the comparison of a result with rendered pictures, which the command line uses as well."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from rhizotwin import engine
from rhizotwin.scenes.dataset import Dataset, load_dataset
from rhizotwin.steps.calls import Progress, require, watch

if TYPE_CHECKING:
    from rhizotwin.recon.results.result import Result
    from rhizotwin.verification.verify import Verification


def verify(
    result: Result | str | Path,
    dataset: Dataset | str | Path,
    *,
    folder: str | Path | None = None,
    device: Literal["auto", "cpu", "cuda"] = "auto",
    monitor: Progress = None,
) -> Verification:
    """Render a result with the twin, and compare it with pictures that the reconstruction did not use.

    Parameters
    ----------
    result : Result or path
        Result, preferably reconstructed with the setting ``pictures.hold_out``, or its folder.
    dataset : Dataset or path
        Dataset from which the result was reconstructed.
    folder : path, optional
        Folder for ``verify.json`` and the residual pictures; by default, nothing is written.
    device : {"auto", "cpu", "cuda"}
        Device for the computation; ``auto`` is the device in use, or otherwise an NVIDIA GPU if available.
    monitor : Monitor, tqdm class, callable or None
        Receiver of the progress.

    Returns
    -------
    Verification
        Verdict, with the methods ``table`` and ``to_dict``.

    Raises
    ------
    UserError
        If the dataset is not that of the result or contains masks, or a file is missing or damaged.
    """
    require("dataset", dataset, "path", "Dataset")
    given = dataset if isinstance(dataset, Dataset) else load_dataset(dataset)
    engine.ensure(device)
    from rhizotwin.stored.load import load_result
    from rhizotwin.verification.verify import verify as compare

    found = load_result(result) if isinstance(result, str | Path) else result
    with watch(monitor, {"verify": 1.0}) as bar:
        return compare(found, given, folder=None if folder is None else Path(folder), monitor=bar)

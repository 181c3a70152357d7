"""Command `rhizotwin verify`."""

import json
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from rhizotwin.steps import calls, command_steps
from rhizotwin.steps.arguments import Computing, DatasetFolder, ResultFolder, output

_OF_PICTURES = ("read", "background", "wall", "silhouettes")
"""Stages of the reconstruction that are repeated before a result is compared with pictures. The progress bar takes
their durations into account."""


def verify(
    result: ResultFolder,
    dataset: DatasetFolder,
    /,
    *,
    folder: Annotated[Path | None, output("FOLDER")] = None,
    as_json: Annotated[bool, Parameter(name="--json", show_default=False)] = False,
    computing: Computing = Computing(),
) -> int:
    """Compare a result with rendered pictures of its own shape, which show whether the result explains the scan.

    The twin renders the reconstructed roots with the calibrated cameras, canister and water, by ray tracing through all
    walls, and compares them with the pictures that 'rhizotwin reconstruct --hold-out 5' did not use. Missing and
    surplus roots, displaced cameras, and a wrong size or refraction of the canister are named. The exit code is 1 if
    the result disagrees with the pictures.

    Parameters
    ----------
    result : Path
        Result folder, written by 'rhizotwin reconstruct'. If all pictures were used, the comparison is weaker.
    dataset : Path
        Dataset from which the result was reconstructed.
    folder : Path, optional
        Folder for verify.json and the residual pictures; default: the folder verify in the result.
    as_json : bool
        Print all numbers as JSON.
    computing : Computing
        Device of the computation, and progress output.

    Examples
    --------
    rhizotwin reconstruct my_dataset -o my_result --hold-out 5
    rhizotwin verify my_result my_dataset
    rhizotwin verify my_result my_dataset --json -o my_check
    """
    from rhizotwin.steps.verification import verify as compare

    command_steps.start_engine(computing.device, quiet=computing.quiet or as_json)
    with computing.bar(**{name: calls.SHARES[name] for name in _OF_PICTURES}, verify=6.0) as bar:
        found = compare(result, dataset, folder=folder or result / "verify", monitor=bar)
    print(json.dumps(found.to_dict(), indent=1) if as_json else found.table())
    return int(not found.agrees)

"""Command `rhizotwin edit`."""

from pathlib import Path
from typing import Annotated

from rhizotwin.steps import results
from rhizotwin.steps.arguments import Progress, ResultFolder, with_metavar
from rhizotwin.steps.arguments import output as output_option


def edit(
    result: ResultFolder,
    /,
    *,
    apply: Annotated[Path, with_metavar("FILE")],
    output: Annotated[Path, output_option("CORRECTED")],
    dataset: Annotated[Path | None, with_metavar("DATASET")] = None,
    progress: Progress = Progress(),
) -> None:
    """Apply saved corrections to a result without a browser.

    The corrections that were made and saved in 'rhizotwin view' are applied, and the corrected result is written to
    another folder. The corrected shape is measured and compared with the pictures. Corrections that contradict the
    pictures widen the 90 % intervals or make the result not reliable.

    Parameters
    ----------
    result : Path
        Result folder, written by 'rhizotwin reconstruct'.
    apply : Path
        Corrections to apply, as saved by 'rhizotwin view' (edits.json in the result folder).
    output : Path
        Folder for the corrected result: new, empty, or an earlier result, which is replaced.
    dataset : Path, optional
        Dataset of the result; needed only if its folder was moved.
    progress : Progress
        Progress output.

    Examples
    --------
    rhizotwin edit my_result --apply my_result/edits.json -o my_corrected
    """
    with progress.bar(**results.EDIT_SHARES) as bar:
        results.edit(result, apply, output, dataset=dataset, monitor=bar)
    from rhizotwin.recon.results import result_traits
    from rhizotwin.report import words
    from rhizotwin.stored import result_files

    summary = result_files.read_summary(output)
    print(f"{result_traits.describe_edits(summary)}: {words.volume_text(summary)[0]}, in {output}")
    if not summary["volume_trusted"]:
        print(f"warning: {summary['volume_verdict']}")
    print(f"next: rhizotwin view {output}")

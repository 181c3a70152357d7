"""Command `rhizotwin traits`."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from rhizotwin.scenes import atomic
from rhizotwin.scenes.formatting import count
from rhizotwin.steps.arguments import check_new_file, list_of, option, output, read_mass_g, with_metavar
from rhizotwin.steps.results import read_traits

if TYPE_CHECKING:
    from rhizotwin.scenes.traits import Traits


def traits(
    results: Annotated[list[Path], with_metavar("RESULT")],
    /,
    *,
    mass_g: Annotated[tuple[float, ...] | None, option(list_of(read_mass_g, once=False), "G,G,...")] = None,
    table: Annotated[Path | None, output("FILE")] = None,
) -> None:
    """Print the traits of results, or write them to a table.

    Each trait (length, diameter, depth, width, angles, ...) is printed with its unit and its 90 % interval, or with the
    remark "not reliable" or "no interval" and the reason. With -o the traits are written to a file: a .csv table with
    one row per result (per plant in a shared canister) and one column per trait, followed by intervals, verdicts and
    reasons; or a .json file that also contains histograms. Traits of roots are empty if no roots were found, such as
    for a sphere.

    Parameters
    ----------
    results : list of Path
        Result folders, folders that contain results ('rhizotwin batch'), or a catalogue (.rhizotwin).
    mass_g : tuple of float, optional
        Fresh masses of the roots in grams, one for each result, separated by commas; default: as for 'reconstruct'.
    table : Path, optional
        Table to write, .csv or .json; must not exist yet.

    Examples
    --------
    rhizotwin traits my_result
    rhizotwin traits my_result --mass-g 1.18
    rhizotwin traits my_result my_other_result -o traits.csv
    rhizotwin traits my_result my_other_result --mass-g 1.18,0.92 -o traits.csv
    """
    if table is not None:
        check_new_file(table, ".csv", ".json")
    found = read_traits(results, mass_g)
    if table is None:
        for one in found:
            _print(one.folder, one.summary, one.traits)
        return
    from rhizotwin.recon.results import result_traits
    from rhizotwin.stored import stored_traits

    if table.suffix.lower() == ".csv":
        atomic.write_text(table, stored_traits.spreadsheet([(one.name, one.summary, one.traits) for one in found]))
    else:
        contents = [
            {
                "result": one.name,
                **result_traits.to_json(one.traits, one.summary, mass_g=one.mass_g),
                **_neighbours(one.folder, one.summary, one.traits),
            }
            for one in found
        ]
        atomic.write_text(table, json.dumps(contents, indent=1, allow_nan=False) + "\n")
    print(f"wrote the traits of {count(len(found), 'result')} to {table}")


def _print(folder: Path, summary: dict[str, Any], one: "Traits") -> None:
    """Print the traits of a result, and of each plant if the result has several plants."""
    from rhizotwin.recon.results import assessments, result_traits
    from rhizotwin.scenes import subject, trait_table
    from rhizotwin.stored import result_files

    whose = str(subject.from_summary(summary, str(folder))) or summary["scene"]
    print(f"{folder} ({whose}){'' if summary['volume_trusted'] else ': ' + summary['volume_verdict']}")
    if edits := result_traits.describe_edits(summary):
        print(f"  manual corrections: {edits}")
    assessed = assessments.assess(summary, one)
    print("\n".join(f"  {line}" for line in trait_table.lines(one, assessed)))
    if summary.get("shoot"):
        print("\n".join(f"  {line}" for line in trait_table.shoot_lines(summary["shoot"])))
    plants = result_traits.traits_by_plant(str(folder), summary, one)
    for own in plants if len(plants) > 1 else ():
        print(f"{folder} ({own.subject})")
        print("\n".join(f"  {line}" for line in trait_table.lines(own.traits, own.assessed)))
    for pair in result_files.read_neighbours(folder) if len(plants) > 1 else ():
        print("\n".join(pair.lines(assessed["total_length_mm"].verdict)))
    if one.tissue_density_g_per_ml is None:
        print("  traits of the mass are shown as a dash, because no mass is given (--mass-g)")
    if one.total_length_mm is None:
        print("  no roots were found, so traits of roots are shown as a dash")


def _neighbours(folder: Path, summary: dict[str, Any], one: "Traits") -> dict[str, Any]:
    """Return the distances and overlaps between the plants of a result as JSON values.

    The result is empty if there is only one plant.
    """
    from rhizotwin.recon.results import assessments
    from rhizotwin.stored import result_files

    found = result_files.read_neighbours(folder)
    verdict = assessments.assess(summary, one)["total_length_mm"].verdict
    return {"neighbours": [{**asdict(pair), "verdict": verdict} for pair in found]} if found else {}

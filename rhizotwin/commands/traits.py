"""`rhizotwin traits`."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from rhizotwin.arguments import list_of, named, option, output, read_mass_g
from rhizotwin.scenes.errors import UserError

if TYPE_CHECKING:
    from rhizotwin.scenes.traits import Traits


def traits(
    results: Annotated[list[Path], named("RESULT")],
    /,
    *,
    mass_g: Annotated[tuple[float, ...] | None, option(list_of(read_mass_g, once=False), "G,G,...")] = None,
    table: Annotated[Path | None, output("FILE")] = None,
) -> None:
    """Print the traits of results, or write them to a table for spreadsheets.

    Print a result's traits (lengths, diameters, depth, width, angles, ...) with their units, each with its 90 %
    interval, or "not reliable" or "not assessed". With -o they go to a file: .csv has one row a result (one a plant,
    where several share a canister) and one column a trait, its unit in the head, then intervals and verdicts; .json has
    every number, histograms too. Traits of centre lines are empty where no roots were found, as for spheres.

    Parameters
    ----------
    results : list of Path
        Results, folders of results, as of 'rhizotwin batch', or a catalogue (.rhizotwin).
    mass_g : tuple of float, optional
        Mass of the roots, one a result in their order; default: as given to 'rhizotwin reconstruct'.
    table : Path, optional
        Table to write, .csv or .json; must not exist yet.

    Examples
    --------
    rhizotwin traits my_result
    rhizotwin traits my_result --mass-g 1.18
    rhizotwin traits my_result my_other_result -o traits.csv
    rhizotwin traits my_result my_other_result --mass-g 1.18,0.92 -o traits.csv
    """
    from rhizotwin.catalogue import sources
    from rhizotwin.recon.results import result_traits
    from rhizotwin.scenes import atomic
    from rhizotwin.stored import result_files, stored_traits

    results = result_files.results_in(sources.expand_results(results))
    if mass_g is not None and len(mass_g) != len(results):
        raise UserError(f"--mass-g has {len(mass_g)} masses for {len(results)} results; give one for each, in their order")
    if table is not None and table.suffix.lower() not in (".csv", ".json"):
        raise UserError(f"{table} must end in .csv or .json")
    if table is not None and table.exists():
        raise UserError(f"{table} exists already; choose another name")
    summaries = [result_files.read_summary(folder) for folder in results]
    given = mass_g or (None,) * len(results)
    masses = [summary.get("mass_g") if mass is None else mass for mass, summary in zip(given, summaries, strict=True)]
    found = [stored_traits.read(folder, mass_g=mass) for folder, mass in zip(results, masses, strict=True)]
    if table is None:
        for folder, summary, one in zip(results, summaries, found, strict=True):
            _print(folder, summary, one)
        return
    if table.suffix.lower() == ".csv":
        rows = [(_name(folder), summary, one) for folder, summary, one in zip(results, summaries, found, strict=True)]
        atomic.write_text(table, stored_traits.spreadsheet(rows))
    else:
        contents = [
            {"result": _name(folder), **result_traits.to_json(one, summary, mass_g=mass), **_neighbours(folder, summary, one)}
            for folder, summary, one, mass in zip(results, summaries, found, masses, strict=True)
        ]
        atomic.write_text(table, json.dumps(contents, indent=1, allow_nan=False) + "\n")
    print(f"wrote the traits of {len(found)} result{'s' if len(found) > 1 else ''} to {table}")


def _print(folder: Path, summary: dict[str, Any], one: "Traits") -> None:
    """Print a result's traits, and those of its plants where there are several."""
    from rhizotwin.recon.results import assessments, result_traits
    from rhizotwin.scenes import subject, trait_table
    from rhizotwin.stored import result_files

    whose = str(subject.of_summary(summary, str(folder))) or summary["scene"]
    print(f"{folder} ({whose}){'' if summary['volume_trusted'] else ': ' + summary['volume_verdict']}")
    if edits := result_traits.edited(summary):
        print(f"  corrected by hand: {edits}")
    assessed = assessments.assess(summary, one)
    print("\n".join(f"  {line}" for line in trait_table.lines(one, assessed)))
    if summary.get("shoot"):
        print("\n".join(f"  {line}" for line in trait_table.shoot_lines(summary["shoot"])))
    plants = result_traits.each(str(folder), summary, one)
    for own in plants if len(plants) > 1 else ():
        print(f"{folder} ({own.subject})")
        print("\n".join(f"  {line}" for line in trait_table.lines(own.traits, own.assessed)))
    for pair in result_files.read_neighbours(folder) if len(plants) > 1 else ():
        print("\n".join(pair.lines(assessed["total_length_mm"].verdict)))
    if one.total_length_mm is None:
        print("  no roots were found as centre lines: what needs them is a dash")


def _neighbours(folder: Path, summary: dict[str, Any], one: "Traits") -> dict[str, Any]:
    """Return how the plants of a result lie to each other, for JSON; nothing where there is one."""
    from rhizotwin.recon.results import assessments
    from rhizotwin.stored import result_files

    found = result_files.read_neighbours(folder)
    verdict = assessments.assess(summary, one)["total_length_mm"].verdict
    return {"neighbours": [{**asdict(pair), "verdict": verdict} for pair in found]} if found else {}


def _name(folder: Path) -> str:
    """Return a result's name for a table: its folder's, also of ``.``."""
    return folder.resolve().name

"""What `rhizotwin traits` does."""

import argparse
import json
from pathlib import Path

from rhizotwin import traits_cli
from rhizotwin.scenes import atomic, trait_table
from rhizotwin.scenes.errors import UserError


def traits(options: argparse.Namespace) -> None:
    """Print the traits of results, or write them to a file."""
    wrong = traits_cli.check(options)
    if wrong is not None:
        raise UserError(wrong)
    if options.output is not None and options.output.exists():
        raise UserError(f"{options.output} exists already; choose another name")
    from rhizotwin.recon.results import result_files, result_traits

    masses = options.mass_g or (None,) * len(options.results)
    summaries = [result_files.read_summary(folder) for folder in options.results]
    masses = [summary.get("mass_g") if mass is None else mass for mass, summary in zip(masses, summaries, strict=True)]
    found = [result_traits.read(folder, mass_g=mass) for folder, mass in zip(options.results, masses, strict=True)]
    if options.output is None:
        for folder, summary, one in zip(options.results, summaries, found, strict=True):
            low, high = summary["volume_interval_mm3"]
            print(f"{folder} ({summary['scene']}), volume between {low:.1f} and {high:.1f} mm3")
            print("\n".join(f"  {line}" for line in trait_table.lines(one)))
            if one.total_length_mm is None:
                print("  no roots were found as centre lines: what needs them is a dash")
        return
    if options.output.suffix.lower() == ".csv":
        rows = [(_name(folder), summary, one) for folder, summary, one in zip(options.results, summaries, found, strict=True)]
        atomic.write_text(options.output, result_traits.spreadsheet(rows))
    else:
        contents = [
            {"result": _name(folder), **result_traits.to_json(one, summary, mass_g=mass)}
            for folder, summary, one, mass in zip(options.results, summaries, found, masses, strict=True)
        ]
        atomic.write_text(options.output, json.dumps(contents, indent=1, allow_nan=False) + "\n")
    print(f"wrote the traits of {len(found)} result{'s' if len(found) > 1 else ''} to {options.output}")


def _name(folder: Path) -> str:
    """Return a result's name for a table: its folder's, also of ``.``."""
    return folder.resolve().name

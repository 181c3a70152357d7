"""The words of `rhizotwin traits`."""

import argparse
from pathlib import Path

from rhizotwin.arguments import Commands, add_command, list_of, mass_g


def add(commands: Commands) -> None:
    """Add the command."""
    parser = add_command(
        commands,
        "traits",
        "print the traits of results, or write them to a table for spreadsheets",
        description="Print a result's traits (lengths, diameters, depth, width, angles, ...) with their units. With -o they go to a file:\n"
        ".csv has one row a result and one column a trait, its unit in the head; .json has every number, histograms too. What\n"
        "needs centre lines is empty for shapes without roots found, such as prints.",
        epilog="examples:\n"
        "  rhizotwin traits my_result\n"
        "  rhizotwin traits my_result --mass-g 1.18\n"
        "  rhizotwin traits my_result my_other_result -o traits.csv\n"
        "  rhizotwin traits my_result my_other_result --mass-g 1.18,0.92 -o traits.csv",
    )
    parser.add_argument("results", type=Path, nargs="+", metavar="RESULT", help="folders made by 'rhizotwin reconstruct'")
    parser.add_argument(
        "--mass-g",
        type=list_of(mass_g, once=False),
        metavar="G,G,...",
        help="mass of the roots, one a result in their order; default: as given to 'rhizotwin reconstruct'",
    )
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="table to write, .csv or .json; must not exist yet")


def check(options: argparse.Namespace) -> str | None:
    """Return what is wrong with the options together, in a sentence, or None."""
    masses, count = options.mass_g, len(options.results)
    if masses is not None and len(masses) != count:
        return f"--mass-g has {len(masses)} masses for {count} results; give one for each, in their order"
    if options.output is not None and options.output.suffix.lower() not in (".csv", ".json"):
        return f"{options.output} must end in .csv or .json"
    return None

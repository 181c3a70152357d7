"""Command line of the benchmarks."""

import inspect
import sys
from collections.abc import Callable, Sequence
from typing import Any

from cyclopts import App, CycloptsError, Parameter

from benchmarks import commands, ladder_commands
from rhizotwin.scenes.errors import UserError

COMMANDS: dict[str, Callable[..., int]] = {
    "accuracy": ladder_commands.accuracy,
    "speed": commands.speed,
    "scaling": commands.scaling,
    "rig": commands.rig,
    "scatter": ladder_commands.scatter_,
    "compare": commands.compare,
    "intervals": commands.intervals,
    "damages": commands.damages,
    "thesis": commands.thesis,
    "growth": commands.growth,
    "freeze": commands.freeze,
    "against": commands.against,
    "fingerprints": commands.fingerprints,
}


def bind(words: Sequence[str]) -> tuple[Callable[..., Any], inspect.BoundArguments]:
    """Return the function of a command line, and its arguments; raise UserError if they are invalid."""
    app = App(
        name="python -m benchmarks",
        help="Measure accuracy and speed of simulation and reconstruction, and compare them with committed baselines.",
        help_format="plaintext",
        default_parameter=Parameter(negative=()),
    )
    for name, function in COMMANDS.items():
        app.command(function, name=name)
    try:
        return app.parse_args(list(words) or ["--help"], exit_on_error=False, print_error=False)[:2]
    except CycloptsError as error:
        raise UserError(" ".join(str(error).split())) from None


def main(words: Sequence[str] | None = None) -> int:
    """Run the benchmarks; return the exit code."""
    try:
        function, bound = bind(sys.argv[1:] if words is None else words)
        return int(function(*bound.args, **bound.kwargs) or 0)
    except UserError as error:
        sys.stderr.write(f"error: {error}\n")
        return 2
    except KeyboardInterrupt:
        sys.stderr.write("stopped\n")
        return 130


if __name__ == "__main__":
    sys.exit(main())

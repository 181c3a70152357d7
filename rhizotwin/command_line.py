"""Command-line parser: a cyclopts application of all commands with help texts and messages for invalid arguments."""

import inspect
import re
from collections.abc import Callable, Sequence
from importlib import import_module
from importlib.metadata import version
from typing import Any, get_args

from cyclopts import App, CycloptsError, Parameter
from cyclopts.exceptions import (
    CoercionError,
    MissingArgumentError,
    RepeatArgumentError,
    UnknownCommandError,
    UnknownOptionError,
    UnusedCliTokensError,
    ValidationError,
)

from rhizotwin.commands import ALONE, COMMANDS, GROUPS, place
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.name_suggestion import most_similar

ABOUT = (
    "Measure the roots of plants in round water canisters: reconstruct shape, volume and traits in 3D from pictures "
    "taken all around the canister, with the refraction of water and wall. A digital twin of the imaging rig simulates "
    "such pictures with known ground truth."
)
MORE = (
    "First steps: rhizotwin demo\n"
    "The same in single steps:\n"
    "  rhizotwin simulate printed_8ml -o my_dataset\n"
    "  rhizotwin reconstruct my_dataset -o my_result\n"
    "  rhizotwin score my_result my_dataset\n"
    "For the options of a command: rhizotwin COMMAND --help. Lengths are in millimetres, angles in degrees."
)
_SECTION = re.compile(r"\n\n(?=\w+\n-+\n)")


def bind(words: Sequence[str]) -> tuple[Callable[..., Any], inspect.BoundArguments]:
    """Parse a command line.

    Returns
    -------
    tuple of (callable, inspect.BoundArguments)
        Function that implements the command, and its arguments.

    Raises
    ------
    UserError
        If an argument is invalid.
    """
    app = build(words)
    if list(words) in ([], *([group] for group in GROUPS - ALONE)):
        words = [*words, "--help"]
    try:
        function, bound, _ = app.parse_args(list(words), exit_on_error=False, print_error=False)
    except CycloptsError as error:
        command = " ".join(["rhizotwin", *(error.command_chain or ())])
        raise UserError(f"{_sentence(error, words)}; see {command} --help") from None
    except RecursionError:  # lists of lists are read as JSON
        raise UserError("the value of an option has too many nested brackets; see rhizotwin --help") from None
    return function, bound


def build(words: Sequence[str] = ()) -> App:
    """Build the cyclopts application.

    Only the module of the command in ``words`` is imported; the docstring of the command is its help text.
    """
    typed_names = [" ".join(words[:count]) for count in (1, 2)]
    app = App(
        name="rhizotwin",
        help=ABOUT,
        help_epilogue=MORE,
        help_format="plaintext",
        version=lambda: version("rhizotwin"),
        default_parameter=Parameter(negative=()),
    )
    groups: dict[str, App] = {}
    for order, (name, short) in enumerate(COMMANDS.items()):
        group, _, step = name.rpartition(" ")
        above = groups[group] if group else app
        if name in GROUPS:
            module, _, function = place(name).partition(":")
            own = getattr(import_module(module), function) if name in typed_names and name in ALONE else None
            help_, examples = _help(own or import_module(module)) if name in typed_names else (short, "")
            groups[name] = App(name=name, help=help_, help_epilogue=examples, sort_key=order)
            if own is not None:
                groups[name].default(own)
            app.command(groups[name])
        elif name in typed_names:
            module, _, function = place(name).partition(":")
            command = getattr(import_module(module), function)
            help_, examples = _help(command)
            above.command(command, name=step, help=help_, help_epilogue=examples, sort_key=order)
        else:
            above.command(place(name), name=step, help=short, sort_key=order)
    app.register_install_completion_command(help="Install shell completion of commands and options (bash, zsh, fish).")
    return app


def _help(source: Any) -> tuple[str, str]:
    """Return the description and the examples from the docstring of a module or function.

    The lines of a paragraph are joined, so that the paragraph is wrapped at the width of the terminal. Indented lines
    are not joined. The descriptions of parameters, which cyclopts reads from the docstring, are joined in place.
    """
    about, *sections = _SECTION.split(inspect.getdoc(source) or "")
    typed = [section.splitlines()[2:] for section in sections if section.startswith("Examples\n")]
    if inspect.isfunction(source):
        source.__doc__ = "\n\n".join([about, *(_joined(section) for section in sections)])
    examples = "\n".join(["examples:", *(f"  {line}" for line in typed[0])]) if typed else ""
    return re.sub(r"(?<=\S)\n(?=\S)", " ", about), examples


def _joined(section: str) -> str:
    """Join the lines of each parameter description in a section of a docstring."""
    lines: list[str] = []
    for line in section.splitlines():
        if line.startswith("    ") and lines[-1].startswith("    "):
            lines[-1] += f" {line.strip()}"
        else:
            lines.append(line)
    return "\n".join(lines)


def _sentence(error: CycloptsError, words: Sequence[str]) -> str:
    """Return the error message for an invalid argument, which includes its name and value."""
    argument = error.argument
    name = "" if argument is None else _name(argument)
    if isinstance(error, MissingArgumentError) and argument is not None:
        if not any(word.partition("=")[0] in argument.names for word in words):
            return f"{name} is missing"
        return f"{name} needs a value; write a value that begins with - as {argument.names[0]}=VALUE"
    if isinstance(error, CoercionError) and error.token is not None:
        name, value = error.token.keyword or name, error.token.value
        if error.msg is not None:
            return f"{name}: {error.msg}"
        choices = get_args(error.target_type)
        return f"{name}: {value!r} is unknown; choose one of {', '.join(choices)}" if choices else f"{name}: {value!r} is invalid"
    if isinstance(error, ValidationError):
        return f"{name}: {error.exception_message}"
    if isinstance(error, UnknownOptionError):
        word = error.token.keyword or error.token.value
        known = [other for one in error.argument_collection for other in one.names]
        return f"unknown option {word}{_suggestion(word, known)}"
    if isinstance(error, UnknownCommandError | UnusedCliTokensError) and error.unused_tokens:
        word, chain = error.unused_tokens[0], " ".join(error.command_chain or ())
        if chain and chain not in GROUPS:
            return f"unexpected argument {word!r}"
        names = [step for group, _, step in (command.rpartition(" ") for command in COMMANDS) if group == chain]
        return f"unknown command {word!r}{_suggestion(word, names)}"
    if isinstance(error, RepeatArgumentError):
        return f"{name or error.token.keyword} is given twice"
    return str(error)


def _name(argument: Any) -> str:
    """Return the name of an argument for messages: its option, such as ``--output (-o)``, or its metavar."""
    options = [name for name in argument.names if name.startswith("-")]
    if not options:
        return str(argument.parameter.metavar or argument.names[0].upper())
    return options[0] + "".join(f" ({other})" for other in options[1:])


def _suggestion(word: str, known: Sequence[str]) -> str:
    near = most_similar(word, known)
    return f"; did you mean {near}?" if near else ""

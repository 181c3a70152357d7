"""Parser of the command line, implemented as a cyclopts application.

It contains all commands and their help texts, and the messages for invalid arguments.
"""

import inspect
import re
from collections.abc import Callable, Sequence
from importlib import import_module
from importlib.metadata import version
from typing import Any, get_args, get_origin

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
    "Measure the roots of plants that grow in round, transparent water canisters. The program reconstructs the 3D shape, "
    "the volume and the traits of the roots from pictures taken all around the canister, and takes into account the "
    "refraction by water and wall. It also controls the imaging rig, and simulates it together with its pictures."
)
MORE = (
    "Terms:\n"
    "  rig      turntable with the canister, light panel behind it, and camera\n"
    "  twin     emulated rig in this program, whose true roots are known (ground truth)\n"
    "  net pot  holder of the plant on the canister, with a strip of printed markers\n"
    "  scene    description of canister, plant and rig: a library name, or a file\n"
    "  ring     one turn of the turntable with the camera at one height and tilt\n"
    "  dataset  folder with the pictures of a scan\n"
    "  result   folder with the roots reconstructed from a dataset\n"
    "  traits   measured properties of roots, such as length, diameter and depth\n"
    "\n"
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

    Only the module of the command in ``words`` is imported. The docstring of a command is its help text.
    """
    typed_names = [" ".join(words[:count]) for count in (1, 2)]
    is_help = not {"--help", "-h"}.isdisjoint(words)
    app = App(
        name="rhizotwin",
        help=ABOUT,
        help_epilogue=MORE,
        help_format="plaintext",
        version=lambda: version("rhizotwin"),
        default_parameter=Parameter(negative=(), show_default=_format_default),
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
            if own is not None and is_help:
                groups[name].usage = _usage(app, name)
        elif name in typed_names:
            module, _, function = place(name).partition(":")
            command = getattr(import_module(module), function)
            help_, examples = _help(command)
            above.command(command, name=step, help=help_, help_epilogue=examples, sort_key=order)
            if is_help:
                above[step].usage = _usage(app, name)
        else:
            above.command(place(name), name=step, help=short, sort_key=order)
    app.register_install_completion_command(help="Install shell completion of commands and options (bash, zsh, fish).")
    return app


def _usage(app: App, name: str) -> str:
    """Return the usage line of a command.

    An argument that may be given several times is followed by three dots.
    """
    from cyclopts.help import format_usage  # slow import

    chain = name.split()
    command = app
    for word in chain:
        command = command[word]
    words = ["[COMMAND]" if word == "COMMAND" else word for word in format_usage(app, chain).plain.split() if word != "[ARGS]"]
    positional = [argument for argument in command.assemble_argument_collection() if argument.index is not None and argument.show]
    required = sum(argument.required for argument in positional)
    words = words[: len(words) - required]
    for argument in positional:
        label = argument.names[0].lstrip("-").upper()
        repeats = get_origin(argument.hint) is list or Ellipsis in get_args(argument.hint)
        words.append(f"{label}{'...' if repeats else ''}" if argument.required else f"[{label}]")
    return " ".join(words)


def _format_default(value: object) -> str | None:
    """Format the default of an option for its help text.

    The result is None if the default is not shown.
    """
    if value is None or value == "" or value == ():
        return None
    values = value if isinstance(value, tuple) else (value,)
    return ",".join(f"{item:g}" if isinstance(item, float) else str(item) for item in values)


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
        name = error.token.keyword or name
        value = error.token.value
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
        word = error.unused_tokens[0]
        chain = " ".join(error.command_chain or ())
        if chain and chain not in GROUPS:
            return f"unexpected argument {word!r}"
        names = [step for group, _, step in (command.rpartition(" ") for command in COMMANDS) if group == chain]
        return f"unknown command {word!r}{_suggestion(word, names)}"
    if isinstance(error, RepeatArgumentError):
        return f"{name or error.token.keyword} is given twice"
    return str(error)


def _name(argument: Any) -> str:
    """Return the name of an argument for messages.

    The name of an option contains all its forms, such as ``--output (-o)``. Any other argument is represented by its
    metavar.
    """
    options = [name for name in argument.names if name.startswith("-")]
    if not options:
        return str(argument.parameter.metavar or argument.names[0].upper())
    return options[0] + "".join(f" ({other})" for other in options[1:])


def _suggestion(word: str, known: Sequence[str]) -> str:
    near = most_similar(word, known)
    return f"; did you mean {near}?" if near else ""

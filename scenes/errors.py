"""Exception with a message for the user, and parts of such messages."""

import sys


class UserError(Exception):
    """Raised for an invalid input, or a limit of the computer, that the user can correct.

    The message is a sentence that states the problem, its location (file, key, value, limit) and a remedy. The command
    line prints the message without a traceback, and exits with a nonzero code.
    """


def pip_install(package: str) -> str:
    """Return the command that installs a package into the environment in which this program runs."""
    return f'"{sys.executable}" -m pip install {package}'


def parser_message(error: ValueError | RecursionError) -> str:
    """Return the message of Python's JSON or TOML parser, without hints for programmers."""
    if isinstance(error, RecursionError):
        return "brackets are nested too deeply"
    return str(error).partition("; use sys.")[0]

"""Exception whose message is shown to the user."""


class UserError(Exception):
    """An invalid input, or a limit of the machine, that the user can correct.

    The message is one sentence that states the problem, its place (file, key, value, limit) and a remedy. The command
    line prints it without a traceback and exits with a nonzero code.
    """


def parser_message(error: ValueError | RecursionError) -> str:
    """Return the message of Python's JSON or TOML parser, without its advice to programmers."""
    if isinstance(error, RecursionError):
        return "brackets are nested too deeply"
    return str(error).partition("; use sys.")[0]

"""The one exception type whose message is meant for the person at the keyboard."""


class UserError(Exception):
    """A mistake in the input, or a limit of the machine, that the user can act on.

    The message is one sentence: what is wrong, where (file, key, value, limit) and what to do. The command line prints
    it without a traceback and exits with a code other than 0.
    """


def parsers_words(error: ValueError | RecursionError) -> str:
    """Say why Python's parser of JSON or TOML gave up, without its advice to programmers."""
    if isinstance(error, RecursionError):
        return "brackets within brackets, too deep"
    return str(error).partition("; use sys.")[0]

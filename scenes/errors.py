"""The one exception type whose message is meant for the person at the keyboard."""


class UserError(Exception):
    """A mistake in the input, or a limit of the machine, that the user can act on.

    The message is one sentence: what is wrong, where (file, key, value, limit) and what to do. The command line prints
    it without a traceback and exits with a code other than 0.
    """

"""Formatting of numbers and errors for users.

Numbers are written without exponents, with as many significant digits as their uncertainty permits. Errors are written
as one sentence.
"""

import errno
import math

from rhizotwin.scenes.errors import UserError

DEBUG_VARIABLE = "RHIZOTWIN_DEBUG"
FULL = (errno.ENOSPC, errno.EDQUOT)
"""Error numbers which indicate that the disk is full."""
NO_FILES = (errno.EMFILE, errno.ENFILE)
"""Error numbers which indicate that no file can be opened, because too many are open."""
TRACEBACK_ADVICE = f"run the command again with {DEBUG_VARIABLE}=1 for a traceback"
"""Advice to users of the command line after an unexpected error."""
STOPPED = "the program was stopped by an unexpected error"
"""Begin of the sentence about an unexpected error on the command line."""


def decimals(half: float) -> int:
    """Return the number of decimals for a value with a 90 % interval of the given half-width.

    The last decimal corresponds to the second significant digit of the half-width.
    """
    return 3 if not half > 0.0 else min(6, max(0, 1 - math.floor(math.log10(half))))


def ml(mm3: float, *, half_mm3: float) -> str:
    """Format a volume in ml. The number of decimals depends on the half-width of its interval (mm3)."""
    return f"{mm3 / 1000.0:.{decimals(half_mm3 / 1000.0)}f}"


def interval_ml(low_mm3: float, high_mm3: float) -> str:
    """Format an interval of a volume in ml, such as ``0.82 to 0.95 ml``."""
    half = 0.5 * (high_mm3 - low_mm3)
    return f"{ml(low_mm3, half_mm3=half)} to {ml(high_mm3, half_mm3=half)} ml"


def round_digits(value: float, digits: int = 3) -> str:
    """Format a number with the given number of significant digits."""
    if value == 0.0 or not math.isfinite(value):
        return "0" if value == 0.0 else "-"
    last = digits - 1 - math.floor(math.log10(abs(value)))
    return f"{round(value, last):.{max(0, last)}f}"


def count(number: int, noun: str, plural: str = "") -> str:
    """Format a number with its noun, such as ``1 dataset`` or ``2 datasets``.

    Parameters
    ----------
    number : int
        Number of things.
    noun : str
        Noun in the singular.
    plural : str
        Plural of the noun; by default, the noun with an s.
    """
    return f"{number} {noun if number == 1 else plural or f'{noun}s'}"


def was(number: int) -> str:
    """Return the verb ``was`` or ``were`` that belongs to a number of things."""
    return "was" if number == 1 else "were"


def printable(text: str) -> str:
    """Replace each control code in a text by a question mark, so that the text cannot control a terminal."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def is_expected(error: BaseException) -> bool:
    """Return whether `error_sentence` explains an error completely, so that no traceback is needed."""
    return isinstance(error, UserError | MemoryError | OSError)


def continued(sentence: str, command: str) -> str:
    """Replace parts of an `error_sentence` that are false in a program that continues after the error.

    Parameters
    ----------
    sentence : str
        Sentence from `error_sentence`.
    command : str
        Name of the running command, such as console.
    """
    advice = f"the traceback is in the terminal in which 'rhizotwin {command}' runs"
    return sentence.replace(STOPPED, "an unexpected error occurred").replace(TRACEBACK_ADVICE, advice)


def error_sentence(error: BaseException) -> str:
    """Return a sentence that explains an error to the user."""
    if isinstance(error, UserError):
        return str(error)
    if isinstance(error, MemoryError):
        return "there is not enough memory; use larger voxels (--voxel-mm) or smaller pictures"
    text = " ".join(str(error).split())[:300]
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        if error.errno in FULL:
            return f"{where}the disk is full; free some space and run the same command again"
        if error.errno in NO_FILES:
            return f"{where}too many files and connections are open; close some, or raise the limit (ulimit -n)"
        return f"{where}{error.strerror or text}; check the path and its permissions"
    return f"{STOPPED} ({type(error).__name__}: {text}); {TRACEBACK_ADVICE}"

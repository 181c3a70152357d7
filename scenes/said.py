"""What people read: numbers and errors.

Numbers have the digits that their uncertainty leaves them and no exponents; an error is one sentence.
"""

import errno
import math

from rhizotwin.scenes.errors import UserError

DEBUG_VARIABLE = "RHIZOTWIN_DEBUG"
FULL = (errno.ENOSPC, errno.EDQUOT)
"""Errors of a disk without space."""


def decimals(half: float) -> int:
    """Return how many decimals a number has whose 90 % interval reaches this far.

    The second digit of the reach is the last told.
    """
    return 3 if not half > 0.0 else min(6, max(0, 1 - math.floor(math.log10(half))))


def ml(mm3: float, *, half_mm3: float) -> str:
    """Return a volume in ml whose interval reaches so far."""
    return f"{mm3 / 1000.0:.{decimals(half_mm3 / 1000.0)}f}"


def between_ml(low_mm3: float, high_mm3: float) -> str:
    """Return an interval in ml: ``0.82 to 0.95 ml``."""
    half = 0.5 * (high_mm3 - low_mm3)
    return f"{ml(low_mm3, half_mm3=half)} to {ml(high_mm3, half_mm3=half)} ml"


def rounded(value: float, digits: int = 3) -> str:
    """Return a number with so many digits that count."""
    if value == 0.0 or not math.isfinite(value):
        return "0" if value == 0.0 else "-"
    last = digits - 1 - math.floor(math.log10(abs(value)))
    return f"{round(value, last):.{max(0, last)}f}"


def printable(text: str) -> str:
    """Return text that cannot steer a terminal, whoever wrote it: a question mark for each control code."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def failure(error: BaseException) -> str:
    """Return the sentence that explains an error to who can do something about it."""
    if isinstance(error, UserError):
        return str(error)
    if isinstance(error, MemoryError):
        return "not enough memory; use larger voxels (--voxel-mm) or smaller pictures"
    text = " ".join(str(error).split())[:300]
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        if error.errno in FULL:
            return f"{where}the disk is full; free some space and run the same command again"
        return f"{where}{error.strerror or text}; check the path and your rights to it"
    what = f"stopped by an unexpected error ({type(error).__name__}: {text})"
    return f"{what}; run it again with {DEBUG_VARIABLE}=1 to see where"

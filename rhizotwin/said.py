"""Numbers as people say them: with the digits that their uncertainty leaves them, and without exponents."""

import math


def decimals(half: float) -> int:
    """Return how many decimals a number has whose 90 % interval reaches this far: the second digit of the reach is the last told."""
    return 3 if not half > 0.0 else min(6, max(0, 1 - math.floor(math.log10(half))))


def ml(mm3: float, *, half_mm3: float) -> str:
    """Return a volume in ml whose interval reaches so far."""
    return f"{mm3 / 1000.0:.{decimals(half_mm3 / 1000.0)}f}"


def rounded(value: float, digits: int = 3) -> str:
    """Return a number with so many digits that count."""
    if value == 0.0 or not math.isfinite(value):
        return "0" if value == 0.0 else "-"
    last = digits - 1 - math.floor(math.log10(abs(value)))
    return f"{round(value, last):.{max(0, last)}f}"

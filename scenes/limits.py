"""Declaration of the limits of numeric fields; `scenes.schema` enforces them."""

from dataclasses import field
from typing import Any


def bounded(default: Any, low: float, high: float) -> Any:
    """Declare a numeric field with inclusive limits (for tuples: of each element).

    Parameters
    ----------
    default : Any
        Value used if a file has none.
    low, high : float
        Minimum and maximum.

    Returns
    -------
    Field
        Field with the limits in its metadata.
    """
    return field(default=default, metadata={"limits": (low, high)})

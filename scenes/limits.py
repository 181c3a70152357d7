"""How a description states the limits of a numeric field; `scenes.schema` enforces them."""

from dataclasses import field
from typing import Any


def bounded(default: Any, low: float, high: float) -> Any:
    """Declare a numeric field with inclusive limits (for tuples: of each element).

    Parameters
    ----------
    default : Any
        Its value where a file has none.
    low, high : float
        Least and greatest value.

    Returns
    -------
    Field
        With the limits in its metadata.
    """
    return field(default=default, metadata={"limits": (low, high)})

"""Declaration of limits for numeric fields, which `scenes.schema` enforces."""

from dataclasses import field
from typing import Any


def bounded(default: Any, low: float, high: float) -> Any:
    """Declare a numeric field with inclusive limits. For a tuple, the limits apply to each element.

    Parameters
    ----------
    default : Any
        Value used if the file does not contain the key.
    low, high : float
        Minimum and maximum permitted values.

    Returns
    -------
    Field
        Dataclass field with the limits in its metadata.
    """
    return field(default=default, metadata={"limits": (low, high)})

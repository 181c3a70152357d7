"""How a description states the limits of a numeric field; `scenes.schema` enforces them."""

from dataclasses import field
from typing import Any


def bounded(default: Any, low: float, high: float) -> Any:
    """Declare a numeric field with inclusive limits (for tuples: of each element)."""
    return field(default=default, metadata={"limits": (low, high)})

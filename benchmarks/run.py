"""Result of a benchmark run."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from benchmarks.metric import Metric

Say = Callable[[str], None]


@dataclass
class Run:
    """Metrics, failures and details of one run."""

    metrics: list[Metric] = field(default_factory=list)
    crashed: dict[str, str] = field(default_factory=dict)
    """Traceback by case."""
    details: dict[str, Any] = field(default_factory=dict)
    """Further data, by case."""

"""What a benchmark run measured."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from benchmarks.metric import Metric

Say = Callable[[str], None]


@dataclass
class Run:
    """Numbers, failures and everything else of one run."""

    metrics: list[Metric] = field(default_factory=list)
    crashed: dict[str, str] = field(default_factory=dict)
    """Traceback by case."""
    details: dict[str, Any] = field(default_factory=dict)
    """Everything else worth keeping, by case."""

"""Interface of an adapter, which implements the protocol of one device.

It receives the bytes of the host and returns bytes with their due times.
"""

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class Reply:
    """Message of a device: a line of text, or a frame."""

    due_s: float
    """Time at which the device begins to send it."""
    data: bytes


class Adapter(Protocol):
    """Protocol of a device, independent of the serial line."""

    def receive(self, data: bytes, now_s: float) -> list[Reply]:
        """Process bytes from the host."""

    def next_s(self) -> float:
        """Return the time of the next action of `poll`; infinity if there is none."""

    def poll(self, now_s: float) -> list[Reply]:
        """Execute actions that are due."""


class Motor(Protocol):
    """Motor of a board; angles are degrees of its own count since power-up."""

    steps_per_deg: float
    acceleration_deg_per_s2: float
    energised: bool

    @property
    def steps(self) -> int:
        """Number of microsteps given."""

    @property
    def full(self) -> bool:
        """Whether the queue is full."""

    @property
    def moving(self) -> bool:
        """Whether the motor is moving."""

    def remaining_s(self, *, moves: int = 0) -> float:
        """Return the time until at most ``moves`` remain."""

    def queue(self, goal_deg: float, speed_deg_per_s: float) -> None:
        """Add a move."""

    def energise(self) -> None:
        """Switch on."""

    def release(self) -> None:
        """Switch off."""

    def stop(self) -> None:
        """Stop at once."""

    def power_up(self) -> None:
        """Reset to the state after power-up."""


class Strip(Protocol):
    """A strip of LEDs."""

    def show(self, rgb: tuple[int, int, int], *, led: int | None = None) -> None:
        """Give LEDs a colour."""

    def dim(self, brightness: int) -> None:
        """Scale all LEDs."""

    def power_up(self) -> None:
        """Go dark."""

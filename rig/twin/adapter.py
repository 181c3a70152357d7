"""Interface of an adapter: the protocol of one device.

It receives the host's bytes, and returns bytes with the times at which they are due.
"""

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class Reply:
    """One message of a device: a line of text, or a frame."""

    due_s: float
    """Time at which the device begins to send it."""
    data: bytes


class Adapter(Protocol):
    """Implements the protocol of a device, without transmission."""

    def receive(self, data: bytes, now_s: float) -> list[Reply]:
        """Receive bytes from the host."""

    def next_s(self) -> float:
        """Return the time of the next action of `poll`; infinity if there is none."""

    def poll(self, now_s: float) -> list[Reply]:
        """Perform the actions that are due."""


class Motor(Protocol):
    """Motor driven by a board; angles are degrees of the motor's own count since power-up."""

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
        """Whether the motor moves."""

    def remaining_s(self, *, moves: int = 0) -> float:
        """Return the time until at most ``moves`` are left."""

    def queue(self, goal_deg: float, speed_deg_per_s: float) -> None:
        """Add a move."""

    def energise(self) -> None:
        """Switch the coils on."""

    def release(self) -> None:
        """Switch the coils off."""

    def stop(self) -> None:
        """Stop immediately."""

    def power_up(self) -> None:
        """Reset to the state after power-up."""


class Strip(Protocol):
    """A strip of LEDs."""

    def show(self, rgb: tuple[int, int, int], *, led: int | None = None) -> None:
        """Set the colour of LEDs."""

    def dim(self, brightness: int) -> None:
        """Set the brightness of all LEDs."""

    def power_up(self) -> None:
        """Switch off, as after power-up."""

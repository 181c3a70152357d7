"""What an adapter is: the protocol of one device.

It is fed with the host's bytes and answers with bytes that are due at a time.
"""

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class Reply:
    """One message of a device: a line of text, a frame."""

    due_s: float
    """When the device begins to send it."""
    data: bytes


class Adapter(Protocol):
    """Speaks for a device; knows nothing of wires."""

    def receive(self, data: bytes, now_s: float) -> list[Reply]:
        """Take bytes from the host."""

    def next_s(self) -> float:
        """Return when `poll` has something to do; infinity when it has not."""

    def poll(self, now_s: float) -> list[Reply]:
        """Do what is due by itself."""


class Motor(Protocol):
    """What a board drives; angles are degrees of the motor's own count since power-up."""

    steps_per_deg: float
    acceleration_deg_per_s2: float
    energised: bool

    @property
    def steps(self) -> int:
        """Microsteps given."""

    @property
    def full(self) -> bool:
        """Whether no further move fits the queue."""

    @property
    def moving(self) -> bool:
        """Whether it moves."""

    def remaining_s(self, *, moves: int = 0) -> float:
        """Return the time until at most ``moves`` are left."""

    def queue(self, goal_deg: float, speed_deg_per_s: float) -> None:
        """Add a move."""

    def energise(self) -> None:
        """Switch on."""

    def release(self) -> None:
        """Switch off."""

    def stop(self) -> None:
        """Stop at once."""

    def power_up(self) -> None:
        """Start anew."""


class Strip(Protocol):
    """A strip of LEDs."""

    def show(self, rgb: tuple[int, int, int], *, led: int | None = None) -> None:
        """Give LEDs a colour."""

    def dim(self, brightness: int) -> None:
        """Scale all LEDs."""

    def power_up(self) -> None:
        """Go dark."""

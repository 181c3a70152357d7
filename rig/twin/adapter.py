"""Interface of an adapter, which implements the protocol of one emulated device.

An adapter receives the host's bytes, and returns bytes with the times at which they are due.
"""

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class Reply:
    """Message of a device: a line of text, or a frame."""

    due_s: float
    """Time at which the device begins to send the message, s."""
    data: bytes


class Adapter(Protocol):
    """Interface of the protocol of a device, which does not include the transmission of bytes."""

    def receive(self, data: bytes, now_s: float) -> list[Reply]:
        """Receive bytes from the host, and return the replies."""

    def next_s(self) -> float:
        """Return the time of the next action of `poll`, s.

        It is infinity if none is scheduled.
        """

    def poll(self, now_s: float) -> list[Reply]:
        """Perform the actions that are due, and return the resulting messages."""


class Motor(Protocol):
    """Interface of a motor that is driven by a board.

    Angles are in degrees, relative to the angle at power-up.
    """

    steps_per_deg: float
    acceleration_deg_per_s2: float
    energised: bool

    @property
    def steps(self) -> int:
        """Number of microsteps sent since power-up."""

    @property
    def full(self) -> bool:
        """Whether the queue of moves is full."""

    @property
    def moving(self) -> bool:
        """Whether the motor is moving."""

    def remaining_s(self, *, moves: int = 0) -> float:
        """Return the time until at most ``moves`` moves remain in the queue, s."""

    def queue(self, goal_deg: float, speed_deg_per_s: float) -> None:
        """Add a move to the queue."""

    def energise(self) -> None:
        """Switch the coils on."""

    def release(self) -> None:
        """Switch the coils off."""

    def stop(self) -> None:
        """Stop immediately, and discard queued moves."""

    def power_up(self) -> None:
        """Reset to the state after power-up."""


class Strip(Protocol):
    """Interface of a strip of LEDs."""

    def show(self, rgb: tuple[int, int, int], *, led: int | None = None) -> None:
        """Set the colour of all LEDs, or of a single LED."""

    def dim(self, brightness: int) -> None:
        """Set the brightness of all LEDs, from 0 to 255."""

    def power_up(self) -> None:
        """Switch all LEDs off, as after power-up."""

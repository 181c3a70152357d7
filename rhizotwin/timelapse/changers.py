"""Placement of a plant's canister on the turntable by a person, by a carousel, or on the emulated rig."""

from collections.abc import Callable
from typing import Protocol

from rhizotwin.rig.devices import Carousel
from rhizotwin.rig.scanning.homing import Ask
from rhizotwin.scenes.errors import UserError
from rhizotwin.timelapse.experiment import Member


class NobodyError(UserError):
    """Raised if no person is available to place a canister, which ends a run."""


class Changer(Protocol):
    """Interface of a device or person that places canisters on the turntable."""

    def change(self, member: Member, reason: str, /) -> None:
        """Place the canister of a plant on the turntable, and return when it is in place.

        Parameters
        ----------
        member : Member
            Plant to be scanned next.
        reason : str
            Message of the previous failed attempt, for example because of a wrong plant on the turntable. It is empty
            at the first attempt.

        Raises
        ------
        NobodyError
            If no person is available.
        UserError
            If the carousel fails.
        """


class PersonChanger:
    """Changer that asks a person to place the canister on the turntable.

    Parameters
    ----------
    ask : Ask or None
        Function that asks a question and returns the answer; None if no person is available.
    """

    def __init__(self, ask: Ask | None) -> None:
        self._ask = ask

    def change(self, member: Member, reason: str, /) -> None:
        """Ask a person to place the canister on the turntable, and wait for confirmation."""
        if self._ask is None:
            raise NobodyError(
                f"the scan of plant {member.name} needs a person who puts its canister on the turntable; run the command in a terminal, "
                'start it from the console, or use a carousel ([schedule] change = "carousel")'
            )
        start = f"{reason[0].upper()}{reason[1:]}. " if reason else ""
        self._ask(f"{start}Put canister {member.canister} (plant {member.name}) on the turntable, then press Enter: ")


class CarouselChanger:
    """Changer that uses a carousel.

    Canisters and positions of the carousel have the same numbers.

    Parameters
    ----------
    carousel : Carousel
        Driver of the carousel.
    """

    def __init__(self, carousel: Carousel) -> None:
        self._carousel = carousel
        self._is_ready = False

    def change(self, member: Member, _reason: str, /) -> None:
        """Load the canister from the carousel."""
        if not self._is_ready:
            self._carousel.prepare()
            self._is_ready = True
        self._carousel.load(member.canister)


class EmulatedHand:
    """Emulated person who always places the right canister on the turntable of the emulated rig.

    Parameters
    ----------
    put : callable
        Function that is called with the number of the canister.
    """

    def __init__(self, put: Callable[[int], object]) -> None:
        self._put = put

    def change(self, member: Member, _reason: str, /) -> None:
        """Place the canister on the emulated turntable."""
        self._put(member.canister)

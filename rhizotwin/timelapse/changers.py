"""Who puts the canister of a plant on the table: a person, a carousel, or the emulated rig's own."""

from collections.abc import Callable
from typing import Protocol

from rhizotwin.rig.devices import Carousel
from rhizotwin.rig.scanning.homing import Ask
from rhizotwin.scenes.errors import UserError
from rhizotwin.timelapse.experiment import Member


class Changer(Protocol):
    """Interface for placing canisters on the turntable."""

    def change(self, member: Member, *, reason: str = "") -> None:
        """Put the canister of a plant on the table; return when it is there.

        Parameters
        ----------
        member : Member
            Plant that is scanned next.
        reason : str
            Message of the failure if this is another try, for example because another plant was on the table.

        Raises
        ------
        UserError
            If there is no one to ask, or the carousel fails.
        """


class PersonChanger:
    """A person, who is asked to put the canister on the table.

    Parameters
    ----------
    ask : Ask or None
        Asks a question and returns the answer; None: there is no one to ask.
    """

    def __init__(self, ask: Ask | None) -> None:
        self._ask = ask

    def change(self, member: Member, *, reason: str = "") -> None:
        """Ask for the canister, and wait for the answer."""
        if self._ask is None:
            raise UserError(
                f"plant {member.name} is due, but there is no one to put its canister on the table: run it in a terminal or from the "
                'console, or use a carousel ([schedule] change = "carousel")'
            )
        start = f"{reason[0].upper()}{reason[1:]}. " if reason else ""
        self._ask(f"{start}Put canister {member.canister} (plant {member.name}) on the table, then press Enter: ")


class CarouselChanger:
    """A carousel, in which each canister stands in the place of its number.

    Parameters
    ----------
    carousel : Carousel
        Its driver.
    """

    def __init__(self, carousel: Carousel) -> None:
        self._carousel = carousel
        self._is_ready = False

    def change(self, member: Member, *, reason: str = "") -> None:  # noqa: ARG002 - for a person
        """Load the canister."""
        if not self._is_ready:
            self._carousel.prepare()
            self._is_ready = True
        self._carousel.load(member.canister)


class EmulatedHand:
    """An emulated person who puts the right canister on the emulated table at once.

    Parameters
    ----------
    put : callable
        Called with the number of the canister.
    """

    def __init__(self, put: Callable[[int], object]) -> None:
        self._put = put

    def change(self, member: Member, *, reason: str = "") -> None:  # noqa: ARG002 - for a person
        """Put the canister on the table."""
        self._put(member.canister)

"""Descriptions of the faults that the twin can simulate.

They occur in the transmission, in a device, or in the camera.
"""

import threading
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from rhizotwin.rig.rig_file import JOINTS
from rhizotwin.scenes.errors import UserError
from rhizotwin.scenes.schema import suggestion

Device = Literal["table", "arm", "camera"]
Where = Literal["reply", "request", "device", "shot"]

FOR_GOOD = 1_000_000


@dataclass(frozen=True, kw_only=True)
class Fault:
    """Fault to be simulated, with the message or the time at which it occurs."""

    kind: str
    """Name of a kind of fault in `MENU`."""
    device: Device
    at_message: int | None = None
    """Number of the message at which the fault occurs, starting at 1. Depending on the kind of fault, the replies,
    requests or pictures of the device are counted."""
    at_s: float | None = None
    """Virtual time from which the fault occurs, s. It affects the first message after this time. If neither
    ``at_message`` nor ``at_s`` is given, the fault occurs immediately."""
    amount: float = 0.5
    """Meaning that depends on the kind of fault: a duration in seconds, a temperature in °C, a factor, or the affected
    fraction of a message from 0 to 1. It is described by `FaultKind.what`."""
    count: int = 1
    """Number of successive messages that are affected."""
    joint: int = 1
    """Index of the arm's joint whose servo is affected. It is 0 for the base."""


@dataclass(frozen=True, kw_only=True)
class FaultKind:
    """Kind of fault that the twin can simulate, with its parameters."""

    name: str
    what: str
    """Description of the fault, which states the meaning of ``amount``."""
    devices: tuple[Device, ...]
    where: Where
    amounts: tuple[float, ...] = (0.1, 0.3, 0.5, 0.7, 0.9)
    """Values of ``amount`` from which one is drawn for a random fault."""
    counts: tuple[int, ...] = (1,)
    """Values of ``count`` from which one is drawn for a random fault."""
    protocol: Literal["lx", "lsc"] | None = None
    """Protocol of the arm for which the fault exists. It is None if the fault exists for both protocols."""


_SERIAL: tuple[Device, ...] = ("table", "arm")
_SEVERAL = (1, 1, 1, 2, 4, FOR_GOOD)

MENU: tuple[FaultKind, ...] = (
    FaultKind(name="reply_dropped", what="a reply is lost", devices=_SERIAL, where="reply", counts=_SEVERAL),
    FaultKind(name="reply_corrupted", what="a bit of a reply is wrong", devices=_SERIAL, where="reply", counts=_SEVERAL),
    FaultKind(
        name="reply_late",
        what="a reply arrives AMOUNT seconds late",
        devices=_SERIAL,
        where="reply",
        amounts=(0.02, 0.1, 0.5, 2.0, 8.0, 20.0, 60.0),
        counts=(1, 1, 3),
    ),
    FaultKind(name="reply_doubled", what="a reply arrives twice", devices=_SERIAL, where="reply", counts=_SEVERAL),
    FaultKind(name="reply_truncated", what="a reply ends too early", devices=_SERIAL, where="reply", counts=_SEVERAL),
    FaultKind(name="garbage", what="noise arrives before a reply", devices=_SERIAL, where="reply", counts=_SEVERAL),
    FaultKind(
        name="echo",
        what="the host receives an echo of transmitted bytes",
        devices=("arm",),
        where="request",
        counts=(1, 5, FOR_GOOD),
        protocol="lx",
    ),
    FaultKind(name="request_corrupted", what="a bit of a request is wrong", devices=_SERIAL, where="request", counts=_SEVERAL),
    FaultKind(name="request_dropped", what="a request is lost", devices=_SERIAL, where="request", counts=_SEVERAL),
    FaultKind(name="ok_missing", what="an ok is lost", devices=("table",), where="reply", counts=_SEVERAL),
    FaultKind(
        name="ok_missing_after_resend",
        what="a line is corrupted, and the ok after the Resend is missing",
        devices=("table",),
        where="request",
    ),
    FaultKind(
        name="busy",
        what="the board reports busy every two seconds for AMOUNT seconds before it replies",
        devices=("table",),
        where="reply",
        amounts=(3.0, 9.0, 45.0),
    ),
    FaultKind(
        name="unasked", what="the board sends an unsolicited frame 8", devices=("arm",), where="reply", counts=_SEVERAL, protocol="lsc"
    ),
    FaultKind(name="reset", what="the board resets", devices=("table",), where="device"),
    FaultKind(name="stopped", what="Marlin halts because of an error", devices=("table",), where="device"),
    FaultKind(
        name="unplugged",
        what="the cable is unplugged, and reconnected after AMOUNT seconds (0: never)",
        devices=_SERIAL,
        where="device",
        amounts=(0.0, 0.5, 3.0, 20.0),
    ),
    FaultKind(
        name="stalled",
        what="a servo is blocked for AMOUNT seconds (0: permanently)",
        devices=("arm",),
        where="device",
        amounts=(0.0, 0.5, 5.0),
    ),
    FaultKind(
        name="overheated", what="a servo has a temperature of AMOUNT degrees", devices=("arm",), where="device", amounts=(70.0, 86.0, 95.0)
    ),
    FaultKind(
        name="brown_out",
        what="the arm's voltage drops for AMOUNT seconds, and the servos lose their torque",
        devices=("arm",),
        where="device",
        amounts=(0.2, 1.0, 10.0),
    ),
    FaultKind(
        name="camera_stopped",
        what="the camera delivers no picture for AMOUNT seconds (0: never again)",
        devices=("camera",),
        where="shot",
        amounts=(0.0, 5.0, 30.0),
    ),
    FaultKind(name="stale_frame", what="the camera delivers an old picture", devices=("camera",), where="shot", counts=(1, 1, 2, FOR_GOOD)),
    FaultKind(
        name="wrong_exposure",
        what="the camera exposes AMOUNT times as long as commanded, and reports it",
        devices=("camera",),
        where="shot",
        amounts=(0.5, 2.0),
        counts=(1, 1, 2, FOR_GOOD),
    ),
)
_KINDS = {kind.name: kind for kind in MENU}
KIND_NAMES: tuple[str, ...] = tuple(_KINDS)


def fault_kind(name: str) -> FaultKind:
    """Return the kind of fault with a given name.

    Raises
    ------
    UserError
        If there is no kind with this name.
    """
    if name not in _KINDS:
        raise UserError(f'there is no fault "{name}"{suggestion(name, list(_KINDS))}; available faults are {", ".join(_KINDS)}')
    return _KINDS[name]


def draw_faults(
    rng: np.random.Generator, kinds: tuple[str, ...], *, messages: int = 100, duration_s: float = 120.0, shots: int = 10
) -> tuple[Fault, ...]:
    """Draw one fault of each kind.

    It occurs at a random time of a scan.

    Parameters
    ----------
    rng : Generator
        Random generator for device, time, amount and count.
    kinds : tuple of str
        Names of the kinds of faults.
    messages, duration_s, shots : int, float, int
        Expected number of replies (or requests) per device, duration (s) and number of pictures of the scan. The times
        of faults are drawn within these limits.

    Returns
    -------
    tuple of Fault
        Faults in the order of ``kinds``.
    """
    faults = []
    for kind in map(fault_kind, kinds):
        device = kind.devices[int(rng.integers(len(kind.devices)))]
        count_at = int(rng.integers(1, (shots if device == "camera" else messages) + 1))
        by_time = device != "camera" and bool(rng.integers(2))
        faults.append(
            Fault(
                kind=kind.name,
                device=device,
                at_message=None if by_time else count_at,
                at_s=float(rng.uniform(0.0, duration_s)) if by_time else None,
                amount=float(rng.choice(kind.amounts)),
                count=int(rng.choice(kind.counts)),
                joint=int(rng.integers(5)),
            )
        )
    return tuple(faults)


def parse_fault(text: str) -> Fault:
    """Parse a fault from text such as ``reset``, ``reply_late table amount=3 at_s=20`` or ``stalled joint=2``.

    Joints are numbered from 1 to 5, as in ``rhizotwin rig jog``.

    Raises
    ------
    UserError
        If the text is invalid; the message states the valid options.
    """
    name, *words = text.split() or [""]
    kind = fault_kind(name)
    device: Device = kind.devices[0]
    values: dict[str, float] = {}
    for word in words:
        key, equals, number = word.partition("=")
        if word in kind.devices:
            device = next(known for known in kind.devices if known == word)
        elif equals and key in ("at_message", "at_s", "amount", "count", "joint"):
            try:
                values[key] = float(number)
            except ValueError:
                raise UserError(f'fault "{text}": {key} must be a number, not {number!r}') from None
            counts, most = key in ("at_message", "count", "joint"), JOINTS if key == "joint" else FOR_GOOD
            if not int(counts) <= values[key] <= most or (counts and values[key] % 1.0):
                must = f"a whole number from 1 to {most}" if counts else f"a number from 0 to {most}"
                raise UserError(f'fault "{text}": {key} must be {must}, not {number}')
        else:
            raise UserError(
                f'fault "{text}": {word!r} is invalid; after {name} use {" or ".join(kind.devices)} and '
                "at_message=N, at_s=SECONDS, amount=X, count=N, joint=N"
            )
    fault = Fault(kind=name, device=device, amount=values.get("amount", kind.amounts[0]))
    return replace(
        fault,
        at_message=int(values["at_message"]) if "at_message" in values else None,
        at_s=values.get("at_s"),
        count=int(values.get("count", 1)),
        joint=int(values.get("joint", 2)) - 1,
    )


class Pending:
    """Set of faults that have not occurred yet.

    It can be used by several threads.
    """

    def __init__(self, faults: tuple[Fault, ...]) -> None:
        for fault in faults:
            fault_kind(fault.kind)
        self._lock = threading.Lock()
        self._left = list(faults)
        self.happened: list[tuple[float, Fault]] = []
        """Faults that have occurred, each with the time of its occurrence, s."""

    def add(self, fault: Fault) -> None:
        """Add a fault to the set."""
        fault_kind(fault.kind)
        with self._lock:
            self._left.append(fault)

    def clear(self) -> None:
        """Remove all faults."""
        with self._lock:
            self._left.clear()

    def due(self, device: Device, where: Where, number: int, now_s: float) -> list[Fault]:
        """Return the faults that affect a message of a device, in the order in which they were added.

        They remain in the set until `use` is called.

        Parameters
        ----------
        device : Device
            Device of the message.
        where : Where
            Place of the fault: reply, request, device or picture.
        number : int
            Number of the message.
        now_s : float
            Time of the twin, s.

        Returns
        -------
        list of Fault
            Faults that are due.
        """
        with self._lock:
            here = [fault for fault in self._left if fault.device == device and fault_kind(fault.kind).where == where]
        return [fault for fault in here if _is_due(fault, number, now_s)]

    def use(self, fault: Fault, now_s: float) -> None:
        """Register that a fault has affected one message."""
        with self._lock:
            self.happened.append((now_s, fault))
            i = next(i for i, left in enumerate(self._left) if left is fault)
            self._left[i : i + 1] = [replace(fault, count=fault.count - 1)] if fault.count > 1 else []

    def next_s(self) -> float:
        """Return the time of the next device fault with a given time, s.

        The result is infinity if there is none.
        """
        with self._lock:
            times = [fault.at_s for fault in self._left if fault.at_s is not None and fault_kind(fault.kind).where == "device"]
        return min(times, default=float("inf"))


def _is_due(fault: Fault, number: int, now_s: float) -> bool:
    if fault.at_message is not None:
        return number >= fault.at_message
    return fault.at_s is None or now_s >= fault.at_s

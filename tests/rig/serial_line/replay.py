"""Port that replays a recording of a bench session (`rig.serial_line.recording`), as a test of the drivers."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rhizotwin.rig.clock import Clock
from rhizotwin.rig.serial_line.recording import FORMAT
from rhizotwin.scenes.errors import UserError


class ReplayError(UserError):
    """Error that is raised if the driver deviates from the replayed recording.

    The class is not a `RigError`, so that drivers do not handle it as a failure of the device.
    """


class ReplayClock:
    """Clock of a replay.

    The time advances only when `sleep` is called, which returns immediately.
    """

    def __init__(self) -> None:
        self._now_s = 0.0

    def now_s(self) -> float:
        """Return the time since the start of the replay, s."""
        return self._now_s

    def sleep(self, seconds: float) -> None:
        """Advance the time without waiting."""
        self._now_s += max(seconds, 0.0)


@dataclass(frozen=True, kw_only=True)
class _Entry:
    line: int
    """Line number in the file, starting at 1."""
    sent: bool
    data: bytes


class ReplayPort:
    """Replacement for a `rig.serial_line.port.Port` that replays a recording.

    The port requires the driver to send the recorded bytes, and returns the recorded replies. Only the order matters,
    not the times: a read returns the next received bytes, unless other bytes were sent before them in the recording. In
    that case time advances by the timeout. After the first difference, every call raises the same error.
    """

    def __init__(self, path: Path, device: str, entries: list[_Entry], clock: Clock) -> None:
        self.url = f"replay of {path}"
        self.device = device
        self.clock = clock
        self._entries = entries
        self._at = 0
        self._done = 0  # bytes of the present entry that were already sent
        self._difference: ReplayError | None = None

    def write(self, data: bytes) -> None:
        """Check that the bytes sent by the driver agree with the recording.

        Raises
        ------
        ReplayError
            If they differ from the bytes sent at this point of the recording.
        """
        self._check()
        left = data
        while left:
            entry = self._entry()
            if entry is None:
                raise self._differs(f"the driver sent {left!r} after the end of the recording")
            if not entry.sent:
                raise self._differs(f"the driver sent {left!r} before it read {entry.data!r}, which was received in line {entry.line}")
            wanted = entry.data[self._done : self._done + len(left)]
            if not left.startswith(wanted):
                same = next(i for i, (a, b) in enumerate(zip(wanted, left, strict=False)) if a != b)
                byte = self._done + same
                raise self._differs(
                    f"{entry.data!r} was sent in line {entry.line}, but the driver differs from byte {byte} onwards: {left[same:]!r}"
                )
            left = left[len(wanted) :]
            self._done += len(wanted)
            if self._done == len(entry.data):
                self._at, self._done = self._at + 1, 0

    def read(self, timeout_s: float) -> bytes:
        """Return the next received bytes of the recording.

        If the recording continues with sent bytes, no bytes are returned and the time advances by the timeout.
        """
        self._check()
        entry = self._entry()
        if entry is None or entry.sent:
            self.clock.sleep(timeout_s)
            return b""
        self._at += 1
        return entry.data

    def discard_input(self) -> None:
        """Skip all received bytes up to the next sent bytes in the recording."""
        read = True
        while read:
            read = bool(self.read(0.0))

    def close(self) -> None:
        """Do nothing, because the end of a replay is checked by `finish`."""

    def finish(self) -> None:
        """Check that the whole recording was replayed.

        Raises
        ------
        ReplayError
            If a part of the recording was not replayed.
        """
        self._check()
        entry = self._entry()
        if entry is not None:
            raise self._differs(
                f"the driver stopped before line {entry.line}, in which {entry.data!r} was {'sent' if entry.sent else 'received'}"
            )

    def _entry(self) -> _Entry | None:
        return self._entries[self._at] if self._at < len(self._entries) else None

    def _check(self) -> None:
        if self._difference is not None:
            raise self._difference

    def _differs(self, what: str) -> ReplayError:
        self._difference = ReplayError(f"{self.device}, {self.url}: {what}")
        return self._difference


def replay_port(path: Path | str, device: str, *, clock: Clock | None = None, session: int = -1) -> ReplayPort:
    """Open the recording of a device for replay.

    Parameters
    ----------
    path : path
        Path of the recording.
    device : str
        Name of the device in the recording: "turntable" or "arm".
    clock : Clock or None
        Clock of the driver. None for a `ReplayClock`, which replays without waiting.
    session : int
        Index of the session in the file. Negative indices count from the end; the default is the last session.

    Returns
    -------
    ReplayPort
        Port that returns the recorded replies of the device.

    Raises
    ------
    UserError
        If the file cannot be read, is damaged, or does not contain the device.
    """
    path = Path(path)
    try:
        lines = path.read_text(encoding="utf-8").split("\n")
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{path}: the file cannot be read as a recording ({error}); check the path") from error
    # the last line is incomplete if a crash has truncated it
    plain = [_parse_line(path, i, line) for i, line in enumerate(lines[:-1], start=1)]
    begins = [i for i, entry in enumerate(plain) if "recording" in entry]
    if not begins or begins[0] != 0 or any(plain[i]["recording"] != FORMAT for i in begins):
        raise UserError(f"{path}: the file is not a recording of format {FORMAT}; give a file written with --record")
    if not -len(begins) <= session < len(begins):
        raise UserError(f"{path}: the recording has {len(begins)} sessions, but session {session} was requested")
    first = begins[session]
    end = min((i for i in begins if i > first), default=len(plain))
    mine = [(i, entry) for i, entry in enumerate(plain[first:end], start=first + 1) if entry.get("device") == device]
    if not mine:
        names = sorted({str(entry["device"]) for entry in plain[first:end] if "device" in entry})
        raise UserError(f"{path}: this session does not contain the device {device!r}; its devices are: {', '.join(names) or 'none'}")
    entries = [_Entry(line=i, sent=entry["sent"], data=entry["data"]) for i, entry in mine if "dir" in entry]
    return ReplayPort(path, device, entries, ReplayClock() if clock is None else clock)


def _parse_line(path: Path, number: int, line: str) -> dict[str, Any]:
    """Parse a line of a recording and check the entries that `replay_port` uses."""
    try:
        plain = json.loads(line)
        if not isinstance(plain, dict):
            raise ValueError("not a JSON object")
        if "dir" in plain:
            plain["sent"] = {">": True, "<": False}[plain["dir"]]
            plain["data"] = bytes.fromhex(plain["hex"])
    except (ValueError, KeyError, TypeError) as error:
        raise UserError(f"{path}: line {number} is damaged ({error!r}); record the session again") from error
    return plain

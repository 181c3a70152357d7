"""Recording of every transmitted byte as JSON lines.

A recording of a bench session can be replayed as a test of the drivers (`tests/rig/serial_line/replay.py`). A file
contains successive sessions. Each session begins with a line ``{"recording": 1, "time": ..., "versions": ...}``. It is
followed by a line ``{"t_s", "device", "open": {"url", "baud"}}`` for each opened port, and by lines ``{"t_s", "device",
"dir": ">" or "<", "hex"}`` for bytes sent to (``>``) and received from (``<``) a device.
"""

import json
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from rhizotwin.rig.errors import RigError
from rhizotwin.scenes.provenance import versions

FORMAT = 1


class Recorder:
    """Writer that appends to a recording. Every line is flushed immediately, so that a crash loses no line.

    Raises
    ------
    RigError
        If the file cannot be written. `record` raises the error only once, because a full disk must not prevent the
        lamps from being switched off.
    """

    def __init__(self, path: Path | str) -> None:
        self._path = Path(path)
        self._broken = False
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._stream = self._path.open("ab", buffering=0)
        except OSError as error:
            raise self._failed(error) from error
        try:
            _end_line(self._path)
            self._put({"recording": FORMAT, "time": datetime.now(UTC).isoformat(), "versions": versions(("pyserial",))})
        except OSError as error:
            self.close()
            raise self._failed(error) from error
        except RigError:
            self.close()
            raise

    def record_open(self, t_s: float, device: str, *, url: str, baud: int) -> None:
        """Record that a port was opened, with its settings.

        Parameters
        ----------
        t_s : float
            Time of the event, s.
        device : str
            Name of the device, such as ``turntable``.
        url, baud : str, int
            URL and baud rate of the port.
        """
        self._put({"t_s": round(t_s, 6), "device": device, "open": {"url": url, "baud": baud}})

    def record(self, t_s: float, device: str, direction: Literal[">", "<"], data: bytes) -> None:
        """Record bytes that were sent (``>``) or received (``<``).

        Parameters
        ----------
        t_s : float
            Time of the transmission, s.
        device : str
            Name of the device, such as ``turntable``.
        direction : {'>', '<'}
            Direction of the transmission: ``>`` to the device, ``<`` from the device.
        data : bytes
            Transmitted bytes.
        """
        self._put({"t_s": round(t_s, 6), "device": device, "dir": direction, "hex": data.hex()})

    def close(self) -> None:
        """Close the file of the recording."""
        with suppress(OSError):
            self._stream.close()

    def _put(self, entry: dict[str, Any]) -> None:
        if self._broken:
            return
        line = json.dumps(entry).encode() + b"\n"
        self._broken = True
        try:
            written = self._stream.write(line)
        except OSError as error:
            raise self._failed(error) from error
        self._broken = written != len(line)
        if self._broken:
            raise RigError(
                f"{self._path}: the recording cannot be written (the disk is full); free some space, or scan without a recording"
            )

    def _failed(self, error: OSError) -> RigError:
        return RigError(f"{self._path}: the recording cannot be written ({error.strerror}); free some space, or scan without a recording")


def _end_line(path: Path) -> None:
    """Remove an incomplete last line, which a crash or a full disk has left."""
    if not path.is_file():  # a pipe or a device
        return
    with path.open("r+b") as stream:
        whole = stream.read().rfind(b"\n") + 1
        if stream.tell() > whole:
            stream.truncate(whole)

"""The lines of Marlin's serial protocol: what is sent, and what each line that comes back means.

After Marlin 2.1's queue.cpp and language.h.
"""

import re
from dataclasses import dataclass
from enum import Enum, auto

MAX_LINE = 96
"""MAX_CMD_SIZE of the firmware."""

POSITION = re.compile(r"^X:\s*(-?\d+\.\d+)\s(?:.*\s)?Count\s+[A-Z]:\s*-?\d")
"""The answer to M114. Versions differ behind X (no E, spaces after the colons); a line cut short has no Count and is
not believed."""
FIRMWARE = re.compile(r"FIRMWARE_NAME:\s*(Marlin\b.*?)(?=\s+[A-Z_]{4,}:|$)")
"""The answer to M115."""
CAPABILITY = re.compile(r"^Cap:([A-Z0-9_]+):1$")


class Kind(Enum):
    """What a line from the board means."""

    OK = auto()
    """A command was taken."""
    LIKE_OK = auto()
    """An ``ok`` that was damaged, or glued to another line: nothing is certain, but asking again will not have to wait
    long."""
    BUSY = auto()
    """A command takes its time."""
    WAIT = auto()
    """The board has nothing to do."""
    REFUSED = auto()
    """A line was not taken; the number is the one that the board wants."""
    ERROR = auto()
    """Some other error, or a refusal that was damaged."""
    UNKNOWN = auto()
    """The firmware does not know the command; its ``ok`` follows all the same."""
    RESET = auto()
    """Part of the greeting after a reset."""
    HALTED = auto()
    """The firmware was killed, or stopped itself."""
    OTHER = auto()
    """What a command prints, or noise."""


@dataclass(frozen=True, kw_only=True)
class Line:
    """A line from the board."""

    kind: Kind
    text: str
    number: int | None = None
    """Of REFUSED: the line that is wanted. Of OK with ADVANCED_OK: the line that was taken."""


_HALTED = re.compile(r"Printer halted|kill\(\) called|M112 Shutdown|Printer stopped due to errors")
_RESET = re.compile(r"^(?:echo:|[^\w/]*)\s*start$|\b(?:External|Brown out|Watchdog|Software) Reset\b|^PowerUp$|^Marlin (?:bugfix-)?\d")
_LAST = re.compile(r"Last Line:\s*(\d+)")
_RESEND = re.compile(r"Resend:\s*N?(\d+)")
_OK = re.compile(r"^ok\b(?:.*?\bN(\d+))?")
_UNKNOWN = re.compile(r'Unknown command:\s*"?([^"]*)')
_NOISE = "".join(map(chr, [*range(33), 127, 0xFFFD]))


def numbered(number: int, text: str) -> bytes:
    """Return a command as the line that is sent: number, command, and the XOR of all bytes before the asterisk.

    Raises
    ------
    ValueError
        When the command would break the line format, or is too long for the firmware's buffer.
    """
    body = f"N{number} {text}"
    checksum = 0
    for byte in body.encode("ascii"):
        checksum ^= byte
    line = f"{body}*{checksum}\n"
    if not text.isprintable() or any(letter in text for letter in "*;") or len(line) > MAX_LINE:
        raise ValueError(f"{text!r} is no command that a line of {MAX_LINE} bytes can carry")
    return line.encode("ascii")


def read_line(raw: bytes) -> Line:
    """Say what a line means.

    Noise at its ends is dropped; within it is kept, since a number from which a damaged digit were dropped would be
    another number.
    """
    text = raw.decode("ascii", errors="replace").strip(_NOISE)
    if _HALTED.search(text):
        return Line(kind=Kind.HALTED, text=text)
    if found := _LAST.search(text):
        return Line(kind=Kind.REFUSED, text=text, number=int(found[1]) + 1)
    if found := _RESEND.search(text):
        return Line(kind=Kind.REFUSED, text=text, number=int(found[1]))
    if _RESET.search(text):
        return Line(kind=Kind.RESET, text=text)
    if found := _OK.match(text):
        return Line(kind=Kind.OK, text=text, number=None if found[1] is None else int(found[1]))
    if "busy:" in text:
        return Line(kind=Kind.BUSY, text=text)
    if text == "wait":
        return Line(kind=Kind.WAIT, text=text)
    if found := _UNKNOWN.search(text):
        return Line(kind=Kind.UNKNOWN, text=found[1].strip())
    if text.lower().startswith("error"):
        return Line(kind=Kind.ERROR, text=text)
    if "ok" in text or len(text) <= len("ok") + 1:
        return Line(kind=Kind.LIKE_OK, text=text)
    return Line(kind=Kind.OTHER, text=text)

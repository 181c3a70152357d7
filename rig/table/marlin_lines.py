"""Lines of Marlin's serial protocol: encoding of commands, and meaning of the board's lines.

After queue.cpp and language.h of Marlin 2.1.
"""

import re
from dataclasses import dataclass
from enum import Enum, auto

MAX_LINE = 96
"""MAX_CMD_SIZE of the firmware."""

POSITION = re.compile(r"^X:\s*(-?\d+\.\d+)\s(?:.*\s)?Count\s+[A-Z]:\s*-?\d")
"""Reply to M114. Versions differ after X (no E, spaces after the colons); a truncated line has no Count and does not
match."""
FIRMWARE = re.compile(r"FIRMWARE_NAME:\s*(Marlin\b.*?)(?=\s+[A-Z_]{4,}:|$)")
"""Reply to M115."""
CAPABILITY = re.compile(r"^Cap:([A-Z0-9_]+):1$")


class Kind(Enum):
    """Meaning of a line from the board."""

    OK = auto()
    """A command was received."""
    LIKE_OK = auto()
    """A damaged ``ok``, or one joined with another line: reception is uncertain, but sending again need not wait long.
    """
    BUSY = auto()
    """A command is still being executed."""
    WAIT = auto()
    """The board is idle."""
    REFUSED = auto()
    """A line was rejected; the number is that of the requested line."""
    ERROR = auto()
    """Another error, or a damaged rejection."""
    UNKNOWN = auto()
    """The firmware does not support the command; an ``ok`` follows nevertheless."""
    RESET = auto()
    """Part of the greeting after a reset."""
    HALTED = auto()
    """The firmware was killed, or halted."""
    OTHER = auto()
    """Output of a command, or noise."""


@dataclass(frozen=True, kw_only=True)
class Line:
    """A line from the board."""

    kind: Kind
    text: str
    number: int | None = None
    """For REFUSED: number of the requested line. For OK with ADVANCED_OK: number of the received line."""


_HALTED = re.compile(r"Printer halted|kill\(\) called|M112 Shutdown|Printer stopped due to errors")
_RESET = re.compile(r"^(?:echo:|[^\w/]*)\s*start$|\b(?:External|Brown out|Watchdog|Software) Reset\b|^PowerUp$|^Marlin (?:bugfix-)?\d")
_LAST = re.compile(r"Last Line:\s*(\d+)")
_RESEND = re.compile(r"Resend:\s*N?(\d+)")
_OK = re.compile(r"^ok\b(?:.*?\bN(\d+))?")
_UNKNOWN = re.compile(r'Unknown command:\s*"?([^"]*)')
_NOISE = "".join(map(chr, [*range(33), 127, 0xFFFD]))


def encode_line(number: int, text: str) -> bytes:
    """Return a command as the line that is sent: number, command, and the XOR of all bytes before the asterisk.

    Raises
    ------
    ValueError
        If the command violates the line format, or is too long for the firmware's buffer.
    """
    body = f"N{number} {text}"
    checksum = 0
    for byte in body.encode("ascii"):
        checksum ^= byte
    line = f"{body}*{checksum}\n"
    if not text.isprintable() or any(letter in text for letter in "*;") or len(line) > MAX_LINE:
        raise ValueError(f"{text!r} is not a command that fits a line of {MAX_LINE} bytes")
    return line.encode("ascii")


def read_line(raw: bytes) -> Line:
    """Return the meaning of a line.

    Noise at its ends is removed; noise inside is kept, since a number without a damaged digit would be another number.
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

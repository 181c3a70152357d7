"""Lines of the serial protocol of Marlin.

Commands are encoded as lines, and the board's lines are interpreted. The formats are those of queue.cpp and language.h
in Marlin 2.1.
"""

import re
from dataclasses import dataclass
from enum import Enum, auto

MAX_LINE = 96
"""Maximum length of a line, bytes. It is MAX_CMD_SIZE of the firmware."""

POSITION = re.compile(r"^X:\s*(-?\d+\.\d+)\s(?:.*\s)?Count\s+[A-Z]:\s*-?\d")
"""Pattern of the reply to M114. Depending on the firmware version, the text after X contains no E, or has spaces after
the colons. A truncated line has no Count and does not match."""
FIRMWARE = re.compile(r"FIRMWARE_NAME:\s*(.+?)(?=,?\s+(?:X-)?[A-Z_]{4,}:|$)(?:.*\bFIRMWARE_VERSION:\s*([^\s,]+))?")
"""Pattern of the reply to M115: name, and the version if it is not part of the name. Prusa, RepRapFirmware, Repetier,
Smoothieware, Sprinter, Teacup and Klipper send the reply too, the last two in the line of the ``ok``."""


class Kind(Enum):
    """Meaning of a line from the board."""

    OK = auto()
    """Confirmation that a command was received."""
    LIKE_OK = auto()
    """Damaged ``ok``, or ``ok`` joined with another line. It is uncertain whether the command was received, but the
    command can be sent again after a short time."""
    BUSY = auto()
    """Report that a command is still being executed."""
    WAIT = auto()
    """Report that the board is idle."""
    REFUSED = auto()
    """Rejection of a line. `Line.number` is the number of the line that the board requests again."""
    ERROR = auto()
    """Any other error, or a damaged rejection."""
    UNKNOWN = auto()
    """Report that the firmware does not support a command. An ``ok`` follows nevertheless."""
    RESET = auto()
    """Line of the greeting that the board sends after a reset."""
    FOREIGN = auto()
    """Line that only firmware other than Marlin sends. `Line.text` is the name of the firmware."""
    HALTED = auto()
    """Report that the firmware was killed or halted."""
    OTHER = auto()
    """Output of a command, or noise."""


@dataclass(frozen=True, kw_only=True)
class Line:
    """Line received from the board, with its meaning."""

    kind: Kind
    text: str
    number: int | None = None
    """Line number in the reply. If the kind is REFUSED, it is the number of the line that the board requests again. OK
    with ADVANCED_OK: number of the received line."""


_HALTED = re.compile(r"Printer halted|kill\(\) called|M112 Shutdown|Printer stopped due to errors")
_RESET = re.compile(r"^(?:echo:|[^\w/]*)\s*start$|\b(?:External|Brown out|Watchdog|Software) Reset\b|^PowerUp$|^Marlin (?:bugfix-)?\d")
_LAST = re.compile(r"Last Line:\s*(\d+)")
_RESEND = re.compile(r"Resend:\s*N?(\d+)")
_OK = re.compile(r"^ok\b(?:.*?\bN(\d+))?")
_FOREIGN = [
    (re.compile(r"^Grbl \S+ \[(FluidNC v\S+)"), r"\1"),
    (re.compile(r"^(\w+ \d[\w.]*) \['\$'"), r"\1"),  # greeting of Grbl, grblHAL and Grbl_Esp32
    (re.compile(r"^(?:error|ALARM):\d+$|^error: (?:Unsupported|Expected|Bad|Invalid)|^\[MSG:.*\]$"), "Grbl, grblHAL or FluidNC"),
    (re.compile(r"^Smoothie$"), "Smoothieware"),
    (re.compile(r'^\{"(?:r|er|sr|qr)":|^tinyg \['), "TinyG or g2core"),
]
"""Lines of firmware that does not answer M115, with its name. Sources: interface.md of Grbl 1.1, report.c of Grbl 0.9
and grblHAL, the wikis of FluidNC, Smoothieware and g2core."""
_UNKNOWN = re.compile(r'Unknown command:\s*"?([^"]*)')
_NOISE = "".join(map(chr, [*range(33), 127, 0xFFFD]))


def encode_line(number: int, text: str) -> bytes:
    """Encode a command as a line.

    The line consists of a number, the command, an asterisk, and the XOR of all bytes before the asterisk.

    Raises
    ------
    ValueError
        If the command violates the line format or is too long for the firmware's buffer.
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
    """Decode a line from the board, and determine its meaning.

    Invalid bytes at both ends of the line are removed. Noise inside is kept, because removing a damaged digit would
    change a number.
    """
    text = raw.decode("ascii", errors="replace").strip(_NOISE)
    for pattern, name in _FOREIGN:
        if found := pattern.search(text):
            return Line(kind=Kind.FOREIGN, text=found.expand(name))
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

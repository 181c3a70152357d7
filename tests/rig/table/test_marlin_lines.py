"""The bytes on the wire to and from a Marlin board."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rhizotwin.rig.table.marlin_lines import CAPABILITY, FIRMWARE, POSITION, Kind, numbered, read_line


@pytest.mark.parametrize(
    ("number", "text", "sent"),
    [
        (0, "M110 N0", b"N0 M110 N0*125\n"),
        (1, "M115", b"N1 M115*39\n"),
        (2, "G91", b"N2 G91*19\n"),
        (3, "G1 X3.6 F1800", b"N3 G1 X3.6 F1800*23\n"),
        (4, "M400", b"N4 M400*35\n"),
        (5, "M114", b"N5 M114*34\n"),
        (6, "M150 S0 R255 U255 B255 P255", b"N6 M150 S0 R255 U255 B255 P255*119\n"),
        (7, "M150 S1 I0 R255", b"N7 M150 S1 I0 R255*123\n"),
        (8, "M18 S0", b"N8 M18 S0*81\n"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_lines_have_number_and_checksum(number: int, text: str, sent: bytes) -> None:
    assert numbered(number, text) == sent


@pytest.mark.parametrize("text", ["G1 X1;", "M117 *", "G1\nG1", "M117 é", "M117 " + "x" * 90])
def test_what_no_line_can_carry_is_refused(text: str) -> None:
    with pytest.raises(ValueError):
        numbered(1, text)


@pytest.mark.parametrize(
    ("raw", "kind", "number"),
    [
        (b"ok", Kind.OK, None),
        (b"ok\r", Kind.OK, None),
        (b"ok N7 P15 B3", Kind.OK, 7),
        (b"ok T:20.0 /0.0", Kind.OK, None),
        (b"\xff\x00ok", Kind.OK, None),
        (b"okay", Kind.LIKE_OK, None),
        (b"T:20ok", Kind.LIKE_OK, None),
        (b"o\xebk", Kind.LIKE_OK, None),
        (b"n", Kind.LIKE_OK, None),
        (b"echo:busy: processing", Kind.BUSY, None),
        (b"busy: paused for user", Kind.BUSY, None),
        (b"wait", Kind.WAIT, None),
        (b"Error:Line Number is not Last Line Number+1, Last Line: 41", Kind.REFUSED, 42),
        (b"Error:checksum mismatch, Last Line: 0", Kind.REFUSED, 1),
        (b"Error:No Checksum with line number, Last Line: 9", Kind.REFUSED, 10),
        (b"Resend: 7", Kind.REFUSED, 7),
        (b"okResend: 7", Kind.REFUSED, 7),
        (b"Resend: N7", Kind.REFUSED, 7),
        (b"Error:checksum mismatch, Lass Line: 3", Kind.ERROR, None),
        (b'echo:Unknown command: "M9999"', Kind.UNKNOWN, None),
        (b"start", Kind.RESET, None),
        (b"echo:start", Kind.RESET, None),
        (b"\xfe\x80start", Kind.RESET, None),
        (b" External Reset", Kind.RESET, None),
        (b" Brown out Reset", Kind.RESET, None),
        (b" Watchdog Reset", Kind.RESET, None),
        (b" Software Reset", Kind.RESET, None),
        (b"PowerUp", Kind.RESET, None),
        (b"Marlin 2.1.2.5", Kind.RESET, None),
        (b"Marlin bugfix-2.1.x", Kind.RESET, None),
        (b"Error:Printer halted. kill() called!", Kind.HALTED, None),
        (b"echo:M112 Shutdown", Kind.HALTED, None),
        (b"Printer stopped due to errors. Fix the error and use M999 to restart.", Kind.HALTED, None),
        (b"FIRMWARE_NAME:Marlin 2.1.3 (x) SOURCE_CODE_URL:y", Kind.OTHER, None),
        (b"//action:start", Kind.OTHER, None),
        (b"X:90.00 Y:0.00 Z:0.00 E:0.00 Count X:1600 Y:0 Z:0", Kind.OTHER, None),
        (b"echo: Last Updated: 2024", Kind.OTHER, None),
    ],
)
def test_lines_are_understood(raw: bytes, kind: Kind, number: int | None) -> None:
    found = read_line(raw)
    assert (found.kind, found.number) == (kind, number)


@given(st.binary(max_size=100))
def test_no_line_is_too_strange(raw: bytes) -> None:
    found = read_line(raw)
    assert (found.number is not None) >= (found.kind is Kind.REFUSED)


@pytest.mark.parametrize(
    ("line", "x"),
    [
        ("X:90.00 Y:0.00 Z:0.00 E:0.00 Count X:1600 Y:0 Z:0", "90.00"),
        ("X:-0.05 Y:0.00 Z:0.00 Count X:-1 Y:0 Z:0", "-0.05"),
        ("X:363.600 Y:0.000 Count X: 6464 Y: 0", "363.600"),
        ("X:90.00 Count X:1600", "90.00"),
        ("X:90.00 Y:0.00 Count A:1600 B:0", "90.00"),
        ("X:90.00 Y:0.00 Z:0.00 Count X:1600ok", "90.00"),
        ("X:90.0", None),
        ("X:90.00 Y:0.00 Z:0.00 E:0.0", None),
        ("X:90.00 Y:0.00 Z:0.00 E:0.00 Count X:", None),
        ("X:9\ufffd.00 Y:0.00 Z:0.00 E:0.00 Count X:1600", None),
        ("X:900 Y:0.00 Z:0.00 E:0.00 Count X:1600", None),
        (" Count X:1600 Y:0 Z:0", None),
        ("0.00 Y:0.00 Count X:1600", None),
        ("okX:90.00 Y:0.00 Count X:1600", None),
    ],
)
def test_positions_of_every_version_are_read_and_cut_ones_refused(line: str, x: str | None) -> None:
    found = POSITION.search(line)
    assert (None if found is None else found[1]) == x


def test_firmware_and_capabilities_are_read() -> None:
    about = "FIRMWARE_NAME:Marlin 2.1.3 (Oct 1 2023) SOURCE_CODE_URL:github.com/x PROTOCOL_VERSION:1.0 MACHINE_TYPE:3D Printer"
    assert (FIRMWARE.search(about) or [""])[1] == "Marlin 2.1.3 (Oct 1 2023)"
    assert (FIRMWARE.search("FIRMWARE_NAME:Marlin 1.1.9") or [""])[1] == "Marlin 1.1.9"
    assert FIRMWARE.search("FIRMWARE_NAME:Repetier_1.0") is None
    assert (CAPABILITY.search("Cap:EMERGENCY_PARSER:1") or [""])[1] == "EMERGENCY_PARSER"
    assert CAPABILITY.search("Cap:EMERGENCY_PARSER:0") is None

"""The bytes on the wire to and from a Marlin board."""

import pytest

from rhizotwin.rig.table.marlin_lines import FIRMWARE, POSITION, Kind, encode_line, read_line

SENT = [
    (0, "M110 N0", b"N0 M110 N0*125\n"),
    (1, "M115", b"N1 M115*39\n"),
    (3, "G1 X3.6 F1800", b"N3 G1 X3.6 F1800*23\n"),
    (6, "M150 S0 R255 U255 B255 P255", b"N6 M150 S0 R255 U255 B255 P255*119\n"),
]


def test_lines_have_number_and_checksum() -> None:
    for number, text, sent in SENT:
        assert encode_line(number, text) == sent
    for text in ("G1 X1;", "M117 *", "G1\nG1", "M117 é", "M117 " + "x" * 90):
        with pytest.raises(ValueError):
            encode_line(1, text)


MEANINGS = {
    (Kind.OK, None): [b"ok", b"ok\r", b"ok T:20.0 /0.0", b"\xff\x00ok"],
    (Kind.OK, 7): [b"ok N7 P15 B3"],
    (Kind.LIKE_OK, None): [b"okay", b"T:20ok", b"o\xebk", b"n"],
    (Kind.BUSY, None): [b"echo:busy: processing", b"busy: paused for user"],
    (Kind.WAIT, None): [b"wait"],
    (Kind.REFUSED, 1): [b"Error:checksum mismatch, Last Line: 0"],
    (Kind.REFUSED, 7): [b"Resend: 7", b"okResend: 7", b"Resend: N7"],
    (Kind.ERROR, None): [b"Error:checksum mismatch, Lass Line: 3"],
    (Kind.UNKNOWN, None): [b'echo:Unknown command: "M9999"'],
    (Kind.RESET, None): [
        *(b"start", b"echo:start", b"\xfe\x80start", b"PowerUp", b"Marlin 2.1.2.5", b"Marlin bugfix-2.1.x"),
        *(b" External Reset", b" Brown out Reset", b" Watchdog Reset", b" Software Reset"),
    ],
    (Kind.HALTED, None): [b"Error:Printer halted. kill() called!", b"echo:M112 Shutdown", b"Printer stopped due to errors. Fix the error"],
    (Kind.OTHER, None): [b"FIRMWARE_NAME:Marlin 2.1.3 (x) SOURCE_CODE_URL:y", b"//action:start", b"X:90.00 Y:0.00 Count X:1600"],
}


def test_lines_are_understood() -> None:
    for meaning, lines in MEANINGS.items():
        for raw in lines:
            found = read_line(raw)
            assert (raw, found.kind, found.number) == (raw, *meaning)


POSITIONS = {
    "X:-0.05 Y:0.00 Z:0.00 Count X:-1 Y:0 Z:0": "-0.05",
    "X:363.600 Y:0.000 Count X: 6464 Y: 0": "363.600",
    "X:90.00 Y:0.00 Count A:1600 B:0": "90.00",
    "X:90.00 Y:0.00 Z:0.00 E:0.00 Count X:": None,
    "X:9\ufffd.00 Y:0.00 Z:0.00 E:0.00 Count X:1600": None,
    "X:900 Y:0.00 Z:0.00 E:0.00 Count X:1600": None,
    "okX:90.00 Y:0.00 Count X:1600": None,
}


def test_positions_are_read_and_cut_ones_refused() -> None:
    assert {line: found and found[1] for line in POSITIONS for found in [POSITION.search(line)]} == POSITIONS


def test_firmware_is_read() -> None:
    about = "FIRMWARE_NAME:Marlin 2.1.3 (Oct 1 2023) SOURCE_CODE_URL:github.com/x PROTOCOL_VERSION:1.0 MACHINE_TYPE:3D Printer"
    assert (FIRMWARE.search(about) or [""])[1] == "Marlin 2.1.3 (Oct 1 2023)"
    assert (FIRMWARE.search("FIRMWARE_NAME:Marlin 1.1.9") or [""])[1] == "Marlin 1.1.9"
    assert FIRMWARE.search("FIRMWARE_NAME:Repetier_1.0") is None

"""Damage to files: what disks, networks, editors and enemies make of them."""

import re

import numpy as np

Rng = np.random.Generator

STRANGE = (
    *(b"nan", b"-nan", b"inf", b"-Infinity", b"NaN", b"1e39", b"-1e308", b"1e999", b"0", b"-0.0", b"-1", b"4294967296", b"1e-320"),
    *(b"9" * 5000, b"null", b"true", b"[]", b"{}", b'""', b'"\\u0000"', b'"\\ud800"', b"[" * 100_000, b'{"a":' * 20_000, b"--", b"\x1b[2J"),
)
"""What stands in place of a number."""


def mutated(data: bytes, rng: Rng) -> bytes:
    """Return a file with one to four damages."""
    for _ in range(int(rng.integers(1, 5))):
        data = DAMAGES[rng.integers(len(DAMAGES))](data, rng)
    return data


def _flip(data: bytes, rng: Rng) -> bytes:
    """Flip bits of some bytes."""
    if not data:
        return data
    changed = bytearray(data)
    for at in rng.integers(0, len(data), int(rng.integers(1, 9))):
        changed[at] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def _stretch(data: bytes, rng: Rng) -> bytes:
    """Remove, repeat, blank or overwrite a stretch, or cut the file there."""
    begin, end = sorted(int(at) for at in rng.integers(0, len(data) + 1, 2))
    end = min(end, begin + int(2 ** rng.uniform(0.0, 12.0)))
    repeated = data[begin:end] * int(rng.integers(2, 6))
    blank = bytes([int(rng.choice([0, 255, 32, 10]))]) * (end - begin)
    middle = (b"", repeated, blank, rng.bytes(end - begin))[rng.integers(4)]
    return data[:begin] if rng.random() < 0.2 else data[:begin] + middle + data[end:]


def _number(data: bytes, rng: Rng) -> bytes:
    """Put something strange in place of a number or a word."""
    found = list(re.finditer(rb"-?\d[\d.eE+-]*|\"[^\"\n]{0,40}\"|true|false|null", data[:200_000]))
    if not found:
        return data
    spot = found[rng.integers(len(found))]
    return data[: spot.start()] + STRANGE[rng.integers(len(STRANGE))] + data[spot.end() :]


def _word(data: bytes, rng: Rng) -> bytes:
    """Put one word of the file in place of another."""
    found = list(re.finditer(rb"[\w.+-]+", data[:200_000]))
    if len(found) < 2:
        return data
    one, other = (found[at] for at in rng.integers(0, len(found), 2))
    return data[: one.start()] + other[0] + data[one.end() :]


DAMAGES = (_flip, _flip, *(_stretch,) * 5, _number, _number, _number, _word)

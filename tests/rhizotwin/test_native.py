"""The stand-in for libatomic: it compares and exchanges as the real function does, and Dr.Jit takes it."""

import ctypes
import platform
import subprocess
import sys

import pytest

from rhizotwin import native

pytestmark = pytest.mark.skipif(
    sys.platform != "linux" or platform.machine() != "x86_64", reason="the stand-in is for Linux on x86-64; elsewhere nothing is loaded"
)

WITHOUT_LIBATOMIC = """
import ctypes, sys
load = ctypes.CDLL
def without(name, *args, **kwargs):
    if name == "libatomic.so.1":
        raise OSError(name)
    return load(name, *args, **kwargs)
ctypes.CDLL = without
from rhizotwin.native import ensure_libatomic
assert ensure_libatomic()
import drjit
libraries = {line.split()[-1] for line in open("/proc/self/maps") if "atomic" in line}
print(*libraries)
"""


def exchange(held: bytes, expected: bytes, desired: bytes) -> tuple[bool, bytes, bytes]:
    """Return whether the words were exchanged, and what is held and expected afterwards."""
    function = getattr(ctypes.CDLL(str(native.ATOMIC)), "__atomic_compare_exchange_16")
    function.restype = ctypes.c_bool
    room = ctypes.create_string_buffer(48)  # cmpxchg16b wants multiples of 16
    at = -ctypes.addressof(room) % 16
    room[at : at + 16] = held
    other = ctypes.create_string_buffer(expected, 16)
    low, high = (ctypes.c_uint64(int.from_bytes(desired[k : k + 8], "little")) for k in (0, 8))
    done = function(ctypes.c_void_p(ctypes.addressof(room) + at), other, low, high, 5, 5)
    return bool(done), room[at : at + 16], other.raw


def test_compare_and_exchange() -> None:
    a, b, c = bytes(range(16)), bytes(range(16, 32)), bytes(range(32, 48))
    assert exchange(a, a, b) == (True, b, a)
    assert exchange(a, c, b) == (False, a, a)
    nearly = a[:15] + b"\xff"  # both halves count
    assert exchange(a, nearly, b) == (False, a, a)


def test_drjit_takes_the_stand_in() -> None:
    done = subprocess.run([sys.executable, "-c", WITHOUT_LIBATOMIC], capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == [str(native.ATOMIC)]

"""Memory by each system's own units and calls."""

import ctypes
import resource
import sys
from types import SimpleNamespace
from unittest.mock import Mock

import pytest

from rhizotwin.scenes import memory


@pytest.mark.parametrize(("system", "mib"), [("linux", 2048.0), ("darwin", 2.0)])
def test_unit_of_the_peak(system: str, mib: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resource, "getrusage", lambda _: SimpleNamespace(ru_maxrss=2 * 1024**2))
    monkeypatch.setattr(sys, "platform", system)
    assert memory.peak_mib() == mib


def test_no_more_is_free_than_there_is() -> None:
    assert 100.0 < memory.available_mib() <= memory.total_mib()


class Function:
    """A function of kernel32 that fills the structure it is given; its attributes can be set as those of ctypes."""

    def __init__(self, size: int, words: dict[int, int]) -> None:
        self.size, self.words = size, words

    def __call__(self, *given: object) -> int:
        """Fill the structure, whose first word must be its size."""
        at = next(ctypes.addressof(one._obj) for one in given if hasattr(one, "_obj"))  # type: ignore[attr-defined]
        assert ctypes.c_uint32.from_address(at).value == self.size
        for place, word in self.words.items():
            ctypes.c_uint64.from_address(at + place).value = word
        return 1


def test_windows_structures_are_those_of_its_headers(monkeypatch: pytest.MonkeyPatch) -> None:
    # by sysinfoapi.h and psapi.h on 64 bits: 64 bytes with the totals at 8 and 16; 72 bytes with the peak at 8
    library = SimpleNamespace(
        GlobalMemoryStatusEx=Function(64, {8: 8 * 2**30, 16: 3 * 2**30}),
        K32GetProcessMemoryInfo=Function(72, {8: 512 * 2**20}),
        GetCurrentProcess=Mock(return_value=-1),
    )
    monkeypatch.setattr(memory, "_kernel32", lambda: library)
    monkeypatch.setattr(sys, "platform", "win32")
    assert (memory.total_mib(), memory.available_mib(), memory.peak_mib()) == (8192.0, 3072.0, 512.0)

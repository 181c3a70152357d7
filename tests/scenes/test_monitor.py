"""Progress: reported, timed and stopped, a bar on a terminal only; memory by each system's own units and calls."""

import ctypes
import io
import resource
import sys
import time
from types import SimpleNamespace
from unittest.mock import Mock

import pytest

from rhizotwin.scenes import memory
from rhizotwin.scenes.monitor import Cancelled, Monitor
from rhizotwin.scenes.terminal import OneBar


def test_every_step_is_reported_and_results_keep_their_order() -> None:
    heard: list[tuple[str, int, int]] = []
    monitor = Monitor(lambda stage, done, total: heard.append((stage, done, total)))
    assert monitor.each(lambda n: n * n, "squares", range(5)) == [0, 1, 4, 9, 16]
    assert heard == [("squares", k, 5) for k in range(1, 6)]
    assert Monitor.of(monitor) is monitor
    with pytest.raises(ZeroDivisionError):
        Monitor.of(None).each(lambda n: 1 // n, "divide", [1, 0, 1])


def test_cancelling_stops_at_the_next_step_and_leaves_the_rest() -> None:
    done: list[int] = []
    monitor = Monitor(lambda _, number, __: monitor.cancel() if number == 2 else None)

    def work(n: int) -> None:
        time.sleep(0.02)
        done.append(n)

    with pytest.raises(Cancelled):
        monitor.each(work, "work", range(50))
    assert len(done) < 50
    with pytest.raises(Cancelled), monitor.stage("next"):
        pytest.fail("a cancelled monitor lets no stage begin")


def test_stages_are_timed_and_add_up_and_their_end_is_reported() -> None:
    monitor, told = Monitor(), list[int]()
    monitor.after_stage = lambda: told.append(len(told))
    for _ in range(2):
        with monitor.stage("sleep"):
            time.sleep(0.02)
            told.append(-1)
    assert told == [-1, 1, -1, 3]
    assert list(monitor.timings_s) == ["sleep"]
    assert 0.04 <= monitor.timings_s["sleep"] < 1.0


@pytest.mark.parametrize("terminal", [False, True])
def test_a_bar_is_drawn_on_a_terminal_only(terminal: bool) -> None:
    stream = io.StringIO()
    stream.isatty = lambda: terminal  # type: ignore[method-assign]
    monitor = OneBar({"carve": 3.0, "surface": 1.0}, stream=stream)
    with monitor.stage("carve"), monitor.steps("level", 4, "level") as step:
        [step() for _ in range(4)]
    with monitor.stage("surface"):
        pass
    monitor.close()
    assert ("\r" in stream.getvalue(), " 75 %" in stream.getvalue()) == (terminal, terminal)
    assert "surface" in stream.getvalue()


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

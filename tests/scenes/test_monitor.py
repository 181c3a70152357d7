"""Progress: reported, timed and stopped, a bar on a terminal only; memory by each system's own units and calls."""

import io
import resource
import sys
import time
from types import SimpleNamespace

import pytest

from rhizotwin.scenes import memory
from rhizotwin.scenes.monitor import Cancelled, Monitor
from rhizotwin.scenes.terminal import OneBar


def test_every_step_is_reported_and_results_keep_their_order() -> None:
    heard: list[tuple[str, int, int]] = []
    monitor = Monitor(lambda stage, done, total: heard.append((stage, done, total)))
    assert monitor.each(lambda n: n * n, "squares", range(5)) == [0, 1, 4, 9, 16]
    assert heard == [("squares", k, 5) for k in range(1, 6)]
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

"""Progress: reported, timed and stopped; one bar on a terminal, one line a stage on a pipe, nothing when quiet."""

import io
import time

import pytest

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


class Terminal(io.StringIO):
    """A text stream that says it is a terminal."""

    def isatty(self) -> bool:
        """Say so."""
        return True


def written(stream: io.StringIO, **options: bool) -> str:
    """Return what a bar writes of two stages, the first of which has steps and takes three quarters."""
    monitor = OneBar({"carve": 3.0, "surface": 1.0}, stream=stream, **options)
    with monitor.stage("carve"), monitor.steps("level", 4, "level") as step:
        [step() for _ in range(4)]
    with monitor.stage("surface"):
        pass
    monitor.close()
    return stream.getvalue()


def test_a_bar_is_one_line_on_a_terminal_only(monkeypatch: pytest.MonkeyPatch) -> None:
    on_a_pipe = written(io.StringIO())
    assert [line.split(":")[0] for line in on_a_pipe.splitlines()] == ["carve", "surface"]
    assert "\r" not in on_a_pipe
    monkeypatch.delenv("NO_COLOR", raising=False)
    bar = written(Terminal())
    assert [text for text in ("carve", "surface", " 75 %", "100 %", "\x1b[38") if text not in bar] == []
    assert written(Terminal(), quiet=True) == ""
    assert "carve: 0.0 s" in written(Terminal(), verbose=True)
    monkeypatch.setenv("NO_COLOR", "1")
    assert "\x1b[38" not in written(Terminal())

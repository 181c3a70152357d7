"""Progress that is told, timed, and stopped."""

import time

import pytest

from rhizotwin.scenes.monitor import Cancelled, Monitor


def test_a_callable_hears_every_step_and_results_keep_their_order() -> None:
    heard: list[tuple[str, int, int]] = []
    monitor = Monitor(lambda stage, done, total: heard.append((stage, done, total)))
    assert monitor.each(lambda n: n * n, "squares", range(5)) == [0, 1, 4, 9, 16]
    assert heard == [("squares", k, 5) for k in range(1, 6)]


def test_cancelling_stops_at_the_next_step_and_leaves_the_rest_undone() -> None:
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
    monitor, told = Monitor(), list[str]()
    monitor.after_stage = lambda: told.append("end")
    for count in range(2):
        with monitor.stage("sleep"):
            time.sleep(0.02)
            assert len(told) == count
    assert told == ["end", "end"]
    assert list(monitor.timings_s) == ["sleep"]
    assert 0.04 <= monitor.timings_s["sleep"] < 1.0


def test_an_error_in_the_work_is_handed_on() -> None:
    with pytest.raises(ZeroDivisionError):
        Monitor.of(None).each(lambda n: 1 // n, "divide", [1, 0, 1])
    assert Monitor.of(monitor := Monitor()) is monitor

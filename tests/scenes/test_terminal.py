"""Progress on a terminal: one bar; on a pipe one line a stage; nothing when quiet."""

import io

import pytest

from rhizotwin.scenes.terminal import OneBar


class Terminal(io.StringIO):
    """A text stream that says it is a terminal."""

    def isatty(self) -> bool:
        """Say so."""
        return True


def work(monitor: OneBar) -> None:
    with monitor.stage("carve"), monitor.steps("level", 4, "level") as step:
        for _ in range(4):
            step()
    with monitor.stage("surface"):
        pass
    monitor.close()


def test_a_pipe_gets_a_line_a_stage_and_nothing_that_moves():
    stream = io.StringIO()
    work(OneBar({"carve": 3.0, "surface": 1.0}, stream=stream))
    lines = stream.getvalue().splitlines()
    assert [line.split(":")[0] for line in lines] == ["carve", "surface"]
    assert "\r" not in stream.getvalue()


def test_a_terminal_gets_one_bar_with_the_stage_and_the_share_done(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("NO_COLOR", raising=False)
    work(OneBar({"carve": 3.0, "surface": 1.0}, stream=(stream := Terminal())))
    assert [text for text in ("carve", "surface", " 75 %", "100 %", "\x1b[38") if text not in stream.getvalue()] == []
    monkeypatch.setenv("NO_COLOR", "1")
    work(OneBar({"carve": 1.0}, stream=(stream := Terminal())))
    assert "\x1b[38" not in stream.getvalue()


def test_quiet_is_silent_and_verbose_tells_both():
    stream = Terminal()
    work(OneBar({"carve": 1.0}, quiet=True, stream=stream))
    assert stream.getvalue() == ""
    work(OneBar({"carve": 1.0}, verbose=True, stream=stream))
    assert "carve: 0.0 s" in stream.getvalue()

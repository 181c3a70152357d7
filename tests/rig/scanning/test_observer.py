"""Who looks on at a scan: hears of every picture, holds it and ends it; nothing that it does harms the pictures."""

import threading
from pathlib import Path

from rhizotwin.rig.scanning.observer import Look, Observer
from tests.rig.fake_devices import World, run


class _Heard(Observer):
    """Keeps what it hears, and holds the scan as often as it should."""

    watches_motion = True

    def __init__(self, holds: int) -> None:
        self.looks: list[Look] = []
        self.lines: list[str] = []
        self.plan: tuple[int, int] = (0, 0)
        self.asked = 0
        self._holds = holds

    def on_plan(self, total: int, done: int) -> None:
        self.plan = (total, done)

    def on_look(self, look: Look) -> None:
        assert threading.current_thread() is not threading.main_thread()
        self.looks.append(look)

    def on_line(self, text: str) -> None:
        self.lines.append(text)

    def holds(self) -> bool:
        self.asked += 1
        self._holds -= 1
        return self._holds >= 0


def test_every_picture_is_heard_of_once_with_what_it_shows(tmp_path: Path):
    world, heard = World(), _Heard(2)
    made = run(world, tmp_path / "d", observer=heard)
    assert heard.plan == (len(made.frames), 0)
    assert [look.frame.file for look in heard.looks] == [frame.file for frame in made.frames]
    assert heard.asked == len(made.frames) + 2
    for look in heard.looks:
        assert look.sighting is not None
        assert len(look.sighting.corners_px) == look.sighting.markers
        assert look.sighting.blur_px is not None
        assert look.motion is not None
        assert look.motion < 0.05
    assert any(line.startswith("camera") for line in heard.lines)

"""Random pairs of faults on the wire to a Marlin board: no wrong angle, no end of waiting."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from rhizotwin.rig.errors import RigError
from rhizotwin.rig.rig_file import TurntablePart
from rhizotwin.rig.table.marlin import MarlinLink
from rhizotwin.rig.table.turntable import MarlinTurntable


@dataclass(frozen=True)
class Hit:
    """A fault of one line on the wire."""

    kind: str
    at: int
    part: float
    late_s: float

    def __call__(self, data: bytes) -> list[tuple[float, bytes]]:
        """Return what becomes of bytes."""
        where = min(int(self.part * len(data)), len(data) - 1)
        changed = data[:where] + bytes((data[where] ^ (1 << (self.at % 8)),)) + data[where + 1 :]
        return {
            "lost": [(0.0, b"")],
            "damaged": [(0.0, changed)],
            "doubled": [(0.0, data), (self.late_s / 100.0, data)],
            "late": [(self.late_s, data)],
            "cut": [(0.0, data[:where])],
            "glued": [(0.0, b"T:20.0 " + data)],
            "split": [(0.0, data[:where]), (0.2, data[where:])],
        }[self.kind]


KINDS = ["lost", "damaged", "doubled", "late", "cut", "glued", "split"]
hits = st.builds(
    Hit, st.sampled_from(KINDS), st.integers(0, 70), st.floats(0.0, 1.0), st.sampled_from((0.004, 0.05, 0.3, 0.7, 2.0, 9.0, 11.0, 30.0))
)


requests = st.builds(Hit, st.sampled_from(["lost", "damaged", "cut"]), st.integers(0, 40), st.floats(0.0, 1.0), st.just(0.0))
resets = st.dictionaries(st.integers(0, 40), st.sampled_from(("", "start\n Watchdog Reset\nMarlin 2.1.2.5\n")), max_size=1)


@settings(max_examples=400, deadline=None)
@given(
    replies=st.lists(hits, max_size=3),
    asked=st.lists(requests, max_size=2),
    resets=resets,
    speaks=st.sampled_from(({}, {"ok_after_resend": False}, {"advanced_ok": True}, {"keeps_alive": False}, {"greets": True})),
    angles=st.lists(st.sampled_from((0.0, 9.0, 18.0, 90.0, 351.0)), min_size=1, max_size=3),
)
def test_no_wrong_angle_is_ever_believed_and_nothing_hangs(
    make_board: Callable[..., Any],
    replies: list[Hit],
    asked: list[Hit],
    resets: dict[int, str],
    speaks: dict[str, bool],
    angles: list[float],
) -> None:
    board = make_board(
        reply_faults={hit.at: hit for hit in replies}, request_faults={hit.at: hit for hit in asked}, resets=resets, **speaks
    )
    table = MarlinTurntable(MarlinLink(board), replace(TurntablePart(), speed_deg_per_s=30.0), board.clock)
    try:
        table.prepare()
        assert not table.knows_zero()
        table.declare(4.5)
        assert board.x_deg == 364.5
        for angle in angles:
            begin_s = board.clock.now_s()
            assert table.move_to(angle) == angle == board.x_deg - 360.0
            assert board.at_rest
            assert board.clock.now_s() - begin_s < 200.0
        assert table.position_deg() == angles[-1]
        table.release()
        assert not board.energised
        assert not table.knows_zero()
    except RigError:
        pass
    assert board.clock.now_s() < 700.0

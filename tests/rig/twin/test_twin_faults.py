"""The fault menu: each does what it says, at the message or moment it says."""

from dataclasses import replace

import pytest

from rhizotwin.rig.twin.adapter import Reply
from rhizotwin.rig.twin.faults import Fault, Pending, parse_fault
from rhizotwin.rig.twin.line import Line
from rhizotwin.scenes.errors import UserError

BAUD = 10_000  # a byte takes a millisecond


class _Parrot:
    """Answers every request with what was heard, and an ok."""

    def __init__(self) -> None:
        self.heard: list[bytes] = []

    def receive(self, data: bytes, now_s: float) -> list[Reply]:
        self.heard.append(data)
        return [Reply(now_s, data), Reply(now_s, b"ok\n")]

    def next_s(self) -> float:
        return float("inf")

    def poll(self, _now_s: float) -> list[Reply]:
        return []


class _Talk:
    """A line to a parrot, and the host at its other end."""

    def __init__(self, *faults: Fault) -> None:
        self.parrot = _Parrot()
        self.pending = Pending(faults)
        self.broken: list[str] = []
        self.line = Line("table", self.parrot, baud=BAUD, pending=self.pending, break_device=self._broken)
        self.now_s = 0.0

    def _broken(self, fault: Fault) -> None:
        self.broken.append(fault.kind)
        self.pending.use(fault, self.now_s)

    def ask(self, data: bytes, *, wait_s: float = 1.0) -> bytes:
        self.line.write(data, self.now_s)
        return self.listen(wait_s)

    def listen(self, wait_s: float) -> bytes:
        until_s = self.now_s + wait_s
        while self.now_s < until_s:
            self.now_s = min(self.line.next_s(), until_s)
            self.line.advance_to(self.now_s)
        return self.line.take()


def table(kind: str, **changes: object) -> Fault:
    return replace(Fault(kind=kind, device="table"), **changes)


def test_bytes_take_their_time_both_ways() -> None:
    talk = _Talk()
    talk.line.write(b"123456789\n", 0.0)
    heard = [(talk.listen(wait_s), list(talk.parrot.heard)) for wait_s in (0.0099, 0.0100, 0.0102)]
    assert heard == [(b"", []), (b"", [b"123456789\n"]), (b"123456789\nok\n", [b"123456789\n"])]


CASES = [
    (table("reply_dropped"), b"ok\n", b"B\nok\n"),
    (table("reply_dropped", at_s=0.5), b"A\nok\n", b"ok\n"),
    (table("reply_truncated", at_message=2, amount=0.4), b"A\no", b"B\nok\n"),
    (table("garbage", amount=0.3), b"\xff\x00\x55\x13A\nok\n", b"B\nok\n"),
    (table("request_dropped"), b"", b"B\nok\n"),
    (table("ok_missing", count=2), b"A\n", b"B\n"),
    (table("reply_corrupted", amount=0.0), b"@\nok\n", b"B\nok\n"),
    (table("request_corrupted", amount=0.0), b"@\nok\n", b"B\nok\n"),
    (table("ok_missing_after_resend", amount=0.0), b"@\n", b"B\nok\n"),
    (table("echo"), b"A\nA\nok\n", b"B\nok\n"),
    (table("unasked"), bytes.fromhex("55 55 05 08 01 01 00") + b"A\nok\n", b"B\nok\n"),
]
"""Faults, and what is heard after each of two requests."""


@pytest.mark.parametrize(("fault", "first", "second"), CASES, ids=[f"{case[0].kind} {case[0].count}" for case in CASES])
def test_what_goes_wrong_on_the_wire(fault: Fault, first: bytes, second: bytes) -> None:
    talk = _Talk(fault)
    assert [talk.ask(b"A\n"), talk.ask(b"B\n"), talk.ask(b"C\n")] == [first, second, b"C\nok\n"]


def test_a_late_reply_comes_late_and_busy_lines_before_it() -> None:
    talk = _Talk(table("reply_late", amount=3.0))
    assert talk.ask(b"A\n", wait_s=2.9) == b""
    assert talk.listen(0.2) == b"A\nok\n"
    talk = _Talk(table("busy", amount=5.0))
    assert talk.ask(b"A\n", wait_s=4.5) == b"echo:busy: processing\n" * 2
    assert talk.listen(4.0) == b"echo:busy: processing\nA\nok\n"


def test_a_device_breaks_at_its_message() -> None:
    talk = _Talk(table("reset", at_message=3))
    talk.ask(b"A\n")
    assert talk.broken == []
    talk.ask(b"B\n")
    assert talk.broken == ["reset"]


def test_faults_are_read_from_words() -> None:
    assert parse_fault("reset") == Fault(kind="reset", device="table", amount=0.1)
    assert parse_fault("reply_late arm amount=3 at_s=20 count=2") == Fault(kind="reply_late", device="arm", at_s=20.0, amount=3.0, count=2)
    assert [parse_fault(f"stalled joint={number}").joint for number in (1, 5)] == [0, 4]
    for text, named in (("stalled joint=6", "from 1 to 5"), ("rest", '"reset"'), ("reset arm", "'arm'"), ("reset at_s=nan", "at_s")):
        with pytest.raises(UserError, match=named):
            parse_fault(text)

"""The twin's ports: in virtual time by pyserial's own way in, and behind pseudo-terminals in real time."""

import pytest
import serial

from rhizotwin.rig.twin.faults import Fault
from rhizotwin.rig.twin.twin import Twin
from rhizotwin.scenes.disturbances import Disturbances
from rhizotwin.scenes.model import Scene

ASK_ARM = bytes.fromhex("55 55 05 03 1c db")  # position of servo 5


def twin(*faults: Fault, seed: int = 0, profile_name: str = "clean") -> Twin:
    return Twin(Scene(disturbances=Disturbances(table_deg=0.1)), seed=seed, profile_name=profile_name, faults=faults, pictures="sketch")


def opened(url: str, timeout: float = 0.25, exclusive: bool | None = None) -> serial.SerialBase:
    return serial.serial_for_url(url, baudrate=115200, timeout=timeout, exclusive=exclusive)


def asked(port: serial.SerialBase, line: bytes) -> bytes:
    """Send a line and read up to its ok."""
    port.write(line + b"\n")
    answer = b""
    for _ in range(400):
        answer += port.read(max(1, port.in_waiting))
        if answer.endswith(b"ok\n"):
            return answer
    return answer


def test_a_read_ends_with_bytes_or_time_out_or_is_refused() -> None:
    rig = twin()
    port = opened(rig.rig.arm.port, timeout=0.5)
    assert port.read(8) == b""
    assert rig.clock.now_s() == pytest.approx(0.5)
    port.write(ASK_ARM)
    assert port.in_waiting == 0
    assert port.read(8)[:5] == bytes.fromhex("55 55 05 05 1c")
    assert 0.5 < rig.clock.now_s() < 0.51
    port.write(ASK_ARM)
    port.timeout = 0.0
    assert any(port.read(1) for _ in range(100_000))  # a loop that only asks gets on, too
    assert rig.clock.now_s() < 1.6
    port.close()
    with serial.serial_for_url(rig.rig.turntable.port, timeout=None) as board:
        board.write(b"G4 S5\n")
        assert board.read(5) == b"echo:"
        assert board.read(42) == b"busy: processing\necho:busy: processing\nok\n"
        with pytest.raises(serial.SerialException, match="forever"):
            board.read(1000)


def talk(seed: int) -> bytes:
    rig = twin(Fault(kind="reply_corrupted", device="table", at_message=3), seed=seed, profile_name="bench")
    board, arm = opened(rig.rig.turntable.port), opened(rig.rig.arm.port)
    heard = b"".join(asked(board, line) for line in (b"M17", b"M115", b"G1 X9 F1800", b"M400", b"M114"))
    arm.write(bytes.fromhex("55 55 05 07 01 f4 01 e8 03 12"))  # servo 5 to 500 in a second
    rig.clock.sleep(0.7)
    arm.write(ASK_ARM)
    heard += arm.read(8)
    board.close()
    arm.close()
    return heard + repr((rig.world.joints_deg, rig.world.table_deg, rig.clock.now_s())).encode()


def test_the_same_seed_gives_the_same_bytes() -> None:
    assert talk(3) == talk(3)
    assert talk(3) != talk(4)


def test_a_pulled_cable_is_as_on_linux() -> None:
    rig = twin(Fault(kind="unplugged", device="table", at_s=1.0, amount=5.0))
    port = opened(rig.rig.turntable.port, timeout=2.0)
    with pytest.raises(serial.SerialException, match="device reports readiness to read but returned no data"):
        port.read(1)
    assert rig.clock.now_s() == pytest.approx(1.0)
    with pytest.raises(serial.SerialException, match="write failed"):
        port.write(b"M114\n")
    with pytest.raises(serial.SerialException, match="No such file"):
        opened(rig.rig.turntable.port)
    rig.clock.sleep(5.0)
    with pytest.raises(serial.SerialException):
        port.read(1)  # a new plug needs a new port
    port.close()
    with opened(rig.rig.turntable.port) as again:
        assert asked(again, b"M114").endswith(b"ok\n")


def test_device_faults_reach_their_device() -> None:
    rig = twin(
        Fault(kind="stalled", device="arm", at_s=1.0, amount=2.0, joint=1),
        Fault(kind="overheated", device="arm", at_s=1.0, amount=90.0, joint=2),
        Fault(kind="brown_out", device="arm", at_s=5.0, amount=1.0),
        Fault(kind="stopped", device="table", at_s=1.0),
    )
    world, joints = rig.world, rig.rig.arm.joints
    shoulder, elbow = world.servos[joints[1].servo], world.servos[joints[2].servo]
    for unit in world.servos.values():
        unit.load(True)
    rig.clock.sleep(1.0)
    assert (shoulder.stalled, elbow.holds, rig.board.commands.stopped) == (True, False, True)
    rig.clock.sleep(4.5)
    assert (shoulder.stalled, world.supply.up) == (False, False)
    assert not any(unit.holds for unit in world.servos.values())
    rig.clock.sleep(2.0)
    assert world.supply.up


def test_a_repaired_twin_has_no_fault_left() -> None:
    rig = twin(
        Fault(kind="unplugged", device="table", at_s=1.0, amount=0.0),
        Fault(kind="overheated", device="arm", at_s=1.0, amount=95.0),
        Fault(kind="stopped", device="table", at_s=1.0),
        Fault(kind="reset", device="table", at_s=9.0),
    )
    rig.clock.sleep(2.0)
    rig.repair()
    with opened(rig.rig.turntable.port) as port:
        rig.clock.sleep(8.0)
        assert b"External Reset" in port.read(500)
    assert not any(unit.hot or unit.celsius > 50 for unit in rig.world.servos.values())
    assert "reset" not in [fault.kind for _, fault in rig.pending.happened]

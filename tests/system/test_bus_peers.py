"""Other people's programs against the emulated bus, unchanged: the vendor's SDK, rustypot, LeRobot where installed.

The emulator answers for the servos, so what these clients read and write is compared with what hexwire itself sees
on the same terminal afterwards.
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import time
from collections.abc import Callable, Iterator

import pytest

from hexwire.bus.servo_bus import ServoBus
from hexwire.link.serial import SerialLink

pytestmark = pytest.mark.system

IDS = (1, 2, 3, 4, 5, 6)
GOALS = {servo_id: 1900 + 20 * servo_id for servo_id in IDS}


@pytest.fixture(params=[pytest.param("1000000", marks=pytest.mark.slow), "0"], ids=["paced", "unpaced"])
def port(request: pytest.FixtureRequest) -> Iterator[str]:
    command = [
        sys.executable,
        "-m",
        "hexwire.cli",
        "sim",
        "bus",
        "--ids",
        "1-6",
        "--until-eof",
        "--baud",
        request.param,
    ]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        yield process.stdout.readline().strip()
        process.stdin.close()
        assert process.wait(30) == 0


def _seen(port: str, name: str) -> dict[int, int | None]:
    with ServoBus(SerialLink(port, 1_000_000)) as bus:
        readings = bus.sync_read(name, IDS)
        return dict(zip(readings.ids, readings.raw, strict=True))


def _again(call: Callable[[], bool]) -> bool:
    """These clients take a stall of milliseconds for a lost answer: ask until the machine is quiet for once."""
    deadline = time.monotonic() + 30.0

    def tried() -> bool:
        try:
            return call()
        except IndexError:
            # The vendor's SDK takes bytes from an answer that it has not received.
            return False

    while not (found := tried()) and time.monotonic() < deadline:
        pass
    return found


def test_the_vendors_sdk(port: str) -> None:
    import scservo_sdk as sdk

    handler = sdk.PortHandler(port)
    assert handler.openPort()
    try:
        assert handler.setBaudRate(1_000_000)
        packets = sdk.PacketHandler(0)
        for servo_id in IDS:
            assert _again(lambda i=servo_id: packets.ping(handler, i) == (777, sdk.COMM_SUCCESS, 0))
        assert _again(lambda: packets.ping(handler, 9)[1] == sdk.COMM_RX_TIMEOUT)
        assert _again(lambda: packets.read2ByteTxRx(handler, 3, 56) == (2054, sdk.COMM_SUCCESS, 0))
        assert _again(lambda: packets.write1ByteTxRx(handler, 3, 41, 50) == (sdk.COMM_SUCCESS, 0))
        reader = sdk.GroupSyncRead(handler, packets, 56, 2)
        for servo_id in IDS:
            assert reader.addParam(servo_id)
        assert _again(lambda: reader.txRxPacket() == sdk.COMM_SUCCESS)
        assert [reader.getData(i, 56, 2) for i in IDS] == [2048 + 3 * place for place in range(6)]
        writer = sdk.GroupSyncWrite(handler, packets, 42, 2)
        for servo_id, goal in GOALS.items():
            assert writer.addParam(servo_id, [sdk.SCS_LOBYTE(goal), sdk.SCS_HIBYTE(goal)])
        assert writer.txPacket() == sdk.COMM_SUCCESS
    finally:
        handler.closePort()
    assert _seen(port, "goal_position") == GOALS
    assert _seen(port, "acceleration")[3] == 50


def test_rustypot(port: str) -> None:
    import rustypot

    bus = rustypot.Sts3215PyController(port, 1_000_000, 1.0)
    try:
        assert all(bus.ping(servo_id) for servo_id in IDS)
        assert list(bus.read_raw_present_position(3)) == [2054]
        bus.write_acceleration(3, 50)
        assert list(bus.sync_read_raw_present_position(list(IDS))) == [2048 + 3 * place for place in range(6)]
        bus.sync_write_raw_goal_position(list(GOALS), list(GOALS.values()))
    finally:
        bus.close()
    assert _seen(port, "goal_position") == GOALS
    assert _seen(port, "acceleration")[3] == 50


if importlib.util.find_spec("lerobot") is not None:

    def test_lerobots_motor_bus(port: str) -> None:
        from lerobot.motors import Motor, MotorNormMode
        from lerobot.motors.feetech import FeetechMotorsBus

        motors = {f"m{i}": Motor(i, "sts3215", MotorNormMode.RANGE_M100_100) for i in IDS}
        bus = FeetechMotorsBus(port, motors)
        bus.connect()
        try:
            assert bus.ping("m2", num_retry=3) == 777
            assert bus.read("Present_Position", "m3", normalize=False, num_retry=3) == 2054
            bus.write("Acceleration", "m3", 50, num_retry=3)
            assert list(bus.sync_read("Present_Position", normalize=False, num_retry=3).values()) == [
                2048 + 3 * place for place in range(6)
            ]
            bus.sync_write("Goal_Position", {f"m{i}": goal for i, goal in GOALS.items()}, normalize=False)
        finally:
            bus.disconnect(disable_torque=False)
        assert _seen(port, "goal_position") == GOALS
        assert _seen(port, "acceleration")[3] == 50

"""Each row of docs/chapter.md is shown by tests, and those that have no other place are here.

`chapter_claims.toml` names them. A row of which the text has changed, or whose test is gone, fails.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from tests.drivers.arms import Arm

from hexwire.drivers.base import RobotDriver
from hexwire.drivers.bus_arm import BusArm
from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.drivers.puma260 import Puma260Driver
from hexwire.drivers.registry import make_driver
from hexwire.drivers.session_driver import SessionDriver
from hexwire.emulator import board_chapter
from hexwire.fleet.remote import RemoteRobot
from hexwire.session.decoder import FrameDecoder
from hexwire.wire.command_frame import Command, Frame
from hexwire.wire.modules import IpcType, ModuleType, known_modules
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import Instruction, make_write, parse_packet
from hexwire.wire.tables import SYNC

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "docs"))

from drawings import robots  # noqa: E402  # found by the line above

PAGE = (ROOT / "docs" / "chapter.md").read_text(encoding="utf-8")
TABLES = re.findall(r"^\| in the chapter .*\n\|---.*\n((?:\|.*\n)+)", PAGE, re.MULTILINE)
ROWS = [[cell.strip() for cell in row.strip("|").split("|")] for table in TABLES for row in table.splitlines()]
CLAIMS = tomllib.loads((ROOT / "tests" / "chapter_claims.toml").read_text(encoding="utf-8"))["claim"]
# The first request below "Read all servo positions" in the chapter's log, and the second.
FIRST = bytes.fromhex(
    "5AFAFA5ADB9A7A68E04E000D2E0000000700000008000000030000003400000082012E0008000200FFFF0604023C02B514220D0A"
)
SECOND = bytes.fromhex(
    "5AFAFA5ADB9A7A6808B79E102F0000000700000008000000030000003400000082012F0008000200FFFF0004023802BF3D860D0A"
)
ANSWER = bytes.fromhex(
    "5AFAFA5A0E00000000A8CB182E0000000800000000000000080000003400000082012E0008000200FFF50004000508EEFFFF0D0A"
)


# -- the table --------------------------------------------------------------------------------------------------


def test_every_row_of_the_page_names_its_tests() -> None:
    assert len(ROWS) > 110
    assert [(claim["row"], claim["says"]) for claim in CLAIMS] == [(row[0], row[2]) for row in ROWS], (
        "a row is new, gone or says something else: look which tests show it"
    )
    assert [claim["row"] for claim in CLAIMS if not claim["tests"]] == []


def test_named_tests_exist() -> None:
    gone = []
    for claim in CLAIMS:
        for test in claim["tests"]:
            file, _, name = test.partition("::")
            text = (ROOT / file).read_text(encoding="utf-8") if (ROOT / file).is_file() else ""
            if not re.search(rf"^\s*def {name}\(", text, re.MULTILINE):
                gone.append(f"{claim['row']}: {test}")
    assert gone == []


def test_a_claim_is_shown_by_behaviour_and_not_by_links_alone() -> None:
    links = "tests/test_chapter_page.py::test_what_the_page_points_to_exists"
    assert [claim["row"] for claim in CLAIMS if claim["says"] and set(claim["tests"]) == {links}] == []


# -- 9.1 and 9.2 ------------------------------------------------------------------------------------------------


def test_arms_on_a_servo_bus_have_no_board() -> None:
    for robot in ("so100", "so101"):
        assert isinstance(make_driver("/dev/null", robot), BusArm)
        assert make_driver("/dev/null", robot).port_leads_to == "adapter"


def test_nothing_is_stuffed_into_a_packet() -> None:
    # HDLC would insert bits after five ones, or escape 0x7D and 0x7E.
    data = b"\xff\xff\x7e\x7d\xff"
    packet = make_write(1, 0x2A, data)
    assert data in packet
    assert len(packet) == 7 + len(data)


@pytest.mark.system
def test_ros_is_optional() -> None:
    """No module of the library needs ROS, and `ipc_common` is imported without any of it."""
    code = (
        "import sys\n"
        "for name in ('rospy', 'rosgraph', 'genpy', 'actionlib', 'rclpy', 'zenoh'): sys.modules[name] = None\n"
        "import hexwire, hexwire.ipc.session, hexwire.ipc.conf, hexwire.drivers.hex7bot\n"
        "import hexwire.control.requests.controlled_arm\n"
        "print(any(name.startswith(('hexwire.ros1', 'hexwire.ros2')) for name in sys.modules))\n"
    )
    done = subprocess.run((sys.executable, "-c", code), capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"


def test_figure_9_6_is_the_class_tree() -> None:
    classes = {each.__name__: each for each in (SessionDriver, BusArm, RemoteRobot, Hex7BotDriver, Puma260Driver)}
    assert {"SessionDriver", "BusArm", "RemoteRobot"} == set(robots.ROBOTS)
    for name, below in robots.ROBOTS.items():
        assert issubclass(classes[name], RobotDriver)
        for other in below:
            assert classes[name] in classes[other].__bases__
    drawn = robots.hierarchy().svg()
    for name in (*classes, "RobotDriver", "Session", "IpcHandle", "Link", "ServoBus"):
        assert f">{name}<" in drawn


def test_a_program_may_send_its_own_requests() -> None:
    driver = make_driver("sim://hex7bot")
    assert isinstance(driver, Hex7BotDriver)
    with driver:
        assert driver.session.request(Command.STATS).body


def test_the_type_of_a_frame() -> None:
    sent, answered = (_frame(data) for data in (FIRST, ANSWER))
    assert (sent.type, answered.type) == (IpcType.SERIAL, ModuleType.ARM_7BOT_ARDUINO_TRX) == (3, 8)
    # It filters nothing: a host takes the answer of any type.
    decoder = FrameDecoder()
    decoder.receive(ANSWER[:24] + b"\x55" + ANSWER[25:], 0.0)
    event = decoder.next_event()
    assert isinstance(event, Frame)
    assert event.type == 0x55


def test_the_list_of_modules_is_a_tuple() -> None:
    assert isinstance(known_modules(), tuple)
    assert {ModuleType(number) for number in range(9)} <= set(known_modules())


# -- 9.3 --------------------------------------------------------------------------------------------------------


def _frame(data: bytes) -> Frame:
    decoder = FrameDecoder()
    decoder.receive(data, 0.0)
    event = decoder.next_event()
    assert isinstance(event, Frame)
    return event


def test_the_log_asks_for_a_load() -> None:
    """The log under "Read all servo positions": servo 6 says its load, then servo 0 its position."""
    asked = [parse_packet(_frame(data).body) for data in (FIRST, SECOND)]
    assert [(each.servo_id, each.instruction) for each in asked] == [(6, Instruction.READ), (0, Instruction.READ)]
    load, position = (each.params[0] for each in asked)
    register = Series.HLS.at(load)
    assert register is not None
    assert register.name == "present_load"
    register = Series.SEVEN_BOT.at(position)
    assert register is not None
    assert register.name == "present_position"


def test_the_check_of_the_sample() -> None:
    frame = _frame(SECOND)
    assert frame.body.hex(" ").upper() == "FF FF 00 04 02 38 02 BF"
    assert ~sum(frame.body[2:-1]) & 0xFF == 0xBF
    # What follows is not part of the packet: it is where dialect 2 has its check.
    assert SECOND[48:50].hex(" ").upper() == "3D 86"


# -- 9.4 --------------------------------------------------------------------------------------------------------


def test_the_sync_word_is_generated() -> None:
    text = (ROOT / "firmware" / "core" / "generated.h").read_text(encoding="utf-8")
    found = re.search(r"\bSYNC = (0x[0-9A-Fa-f]+)", text)
    assert found is not None
    assert int(found[1], 16) == SYNC == 0x5AFAFA5A


def test_the_delays_of_a_read() -> None:
    """The listing of servo_read: delay(10) after the packet, and delay(2) after each of 8 bytes."""
    assert pytest.approx(26) == 1000 * (board_chapter._READ_WAIT + 8 * board_chapter._BYTE_WAIT)


def test_states_a_second_of_the_sketch() -> None:
    """In simulated time; on a real line, with the host's own time, it is never more."""
    arm = Arm(1, 115200)
    begun = arm.clock.time
    for _ in range(20):
        arm.driver.read()
    rate = 20 / (arm.clock.time - begun)
    assert 3 <= rate < 4
    for page, words in (
        ("docs/figures.md", "from the chapter's firmware three times a second"),
        ("docs/ros.md", "3 joint states a second"),
    ):
        assert words in (ROOT / page).read_text(encoding="utf-8"), page


def test_names_of_registers() -> None:
    for series in (Series.HLS, Series.STS_SMS, Series.SCS):
        status = series.at(0x41)
        assert status is not None
        assert (status.name, "w" in status.access) == ("status", False)
    assert Series.STS_SMS.register("goal_position").address == 0x2A
    assert Series.SEVEN_BOT.register("target_position").address == 0x2A
    for name in ("goal_position", "target_position"):
        # Both names are registers of a Feetech servo, and not the same one.
        assert Series.HLS.register(name)
    assert Series.HLS.register("target_position").address != Series.HLS.register("goal_position").address

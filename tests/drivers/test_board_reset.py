"""A board that moves its arm at a reset: the emulated sketch does it, and a warning comes before."""

from __future__ import annotations

import logging
import os
import stat
from pathlib import Path

import pytest
from tests.drivers.arms import Arm

from hexwire.drivers.board_reset import warn_of_reset
from hexwire.drivers.bus_arm import BusArm
from hexwire.drivers.registry import make_driver
from hexwire.drivers.stop_memory import CalmBoard
from hexwire.emulator.board_chapter import MIDDLE
from hexwire.errors import LinkError
from hexwire.link import ports, serial_port
from hexwire.link.open import make_link
from hexwire.link.ports import PortInfo
from hexwire.wire.command_frame import Command
from hexwire.wire.servo_packet import make_ping

AFTER_RESET = 5.0


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


@pytest.mark.parametrize("baud", [0, 115200])
def test_the_sketch_drives_its_joints_home_at_a_reset(baud: int) -> None:
    for faults in ((), ("sketch",), ("sketch", "reset:2")):
        arm = Arm(1, baud, faults, attach=False)
        before = arm.shafts()
        arm.wait(1.0)
        assert arm.shafts() == before, "it begins at rest"
        if "reset:2" not in faults:
            arm.board.reset(arm.clock.time)
        arm.wait(AFTER_RESET)
        if not faults:
            assert arm.shafts() == before, "only the sketch does it"
            continue
        assert arm.shafts() == pytest.approx([MIDDLE] * 7, abs=12), faults
        assert all(arm.torques())
        # And it answers again: nothing of its own moves is left for the first who asks.
        arm.driver.attach()
        assert not arm.driver.read().silent


@pytest.mark.parametrize("after", [0.0, 0.2, 0.5, 0.7, 0.9])
def test_a_sketch_that_had_half_a_frame_when_it_began_to_listen_loses_no_request(after: float) -> None:
    """While it starts, 63 bytes of what is sent are kept: a frame, and the beginning of another."""
    arm = Arm(1, 115200, ("sketch",), attach=False)
    arm.board.reset(arm.clock.time)
    arm.wait(after)
    arm.driver.attach()
    assert arm.driver.ioctl(Command.PING, make_ping(1)) == bytes.fromhex("FFF5010600F8")
    assert not arm.driver.read().silent


def test_what_cannot_be_opened_is_not_warned_of_until_it_can(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file = tmp_path / "file"
    file.write_text("")
    port = tmp_path / "port"
    for query in ("", "?backend=pyserial"):
        assert not warn_of_reset(make_link(f"{file}{query}"))
        assert not warn_of_reset(make_link(f"{port}{query}"))
    assert not caplog.messages
    # The same driver tries again: by then it has been plugged in.
    arm = Arm(1, attach=False)
    arm.link.url = "tcp://127.0.0.1:1"
    arm.link.lost = True
    for there in (False, True, True):
        arm.link.may_reset = there  # type: ignore[attr-defined]  # as of links to a port
        with pytest.raises(LinkError):
            arm.driver.attach()
        assert len(caplog.messages) == int(there)


def test_a_board_of_hexwire_moves_nothing_at_a_reset() -> None:
    arm = Arm(2, 0, ("sketch", "reset:2"), attach=False)
    before = arm.shafts()
    arm.wait(AFTER_RESET)
    assert arm.shafts() == before


def test_every_link_whose_opening_may_reset_a_board_is_warned_of_before(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    master, slave = os.openpty()
    terminal = os.ttyname(slave)
    os.fchmod(slave, stat.S_IMODE(os.fstat(slave).st_mode) | stat.S_ISVTX)
    cases = {
        "/dev/null": True,
        "/dev/null?backend=pyserial": True,
        terminal: True,
        f"{terminal}?backend=pyserial": True,
        "tcp://127.0.0.1:9": True,
        "udp://127.0.0.1:9": False,
        "sim://hex7bot?dialect=1": False,
    }
    for url, warned in cases.items():
        caplog.clear()
        warn_of_reset(make_link(url))
        assert ["keep clear" in line and "10 uF" in line for line in caplog.messages] == [True] * warned, url
    os.fchmod(slave, stat.S_IMODE(os.fstat(slave).st_mode) & ~stat.S_ISVTX)
    assert not serial_port.may_reset(terminal), "a terminal of another program has no DTR"
    os.close(slave)
    os.close(master)


def test_the_warning_comes_before_the_link_is_opened_once_and_again_after_a_loss(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    for dialect in (1, 2):
        arm = Arm(dialect, attach=False)
        seen: list[int] = []
        plain = arm.link.open
        # A port of its own for each board; what they are is the kernel's business.
        arm.link.url = f"tcp://127.0.0.1:{dialect}"
        arm.link.may_reset = True  # type: ignore[attr-defined]  # as of links to a port

        def opening(seen: list[int] = seen, plain: object = plain) -> None:
            seen.append(sum("opening it may reset" in line for line in caplog.messages))
            plain()  # type: ignore[operator]  # a method

        monkeypatch.setattr(arm.link, "open", opening)
        caplog.clear()
        caplog.set_level(logging.WARNING)
        arm.link.lost = True
        for _ in range(3):
            with pytest.raises(LinkError):
                arm.driver.attach()
        arm.link.lost = False
        arm.driver.attach()
        assert seen == [1, 1, 1, 1], "once, and before the first try"
        arm.driver.detach()
        arm.driver.attach()
        assert seen[-1] == (2 if dialect == 1 else 1), "hexwire's firmware is known from then on"
        arm.driver.detach()


@pytest.mark.parametrize("serial", ["", "7563"])
def test_a_board_is_known_until_it_is_unplugged_or_has_another_firmware(
    serial: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    link = make_link("/dev/null")
    # Any character device will do; a serial number does not say which firmware it has got elsewhere.
    usb = PortInfo("/dev/null", 0x2341, 0x42, serial, likely_board=True)
    monkeypatch.setattr("hexwire.link.ports.find_port", lambda path: usb)
    board = CalmBoard(link)
    assert not board.known
    board.note(calm=True)
    assert CalmBoard(link).known
    board.note(calm=False)
    assert not CalmBoard(link).known
    board.note(calm=True)
    plain = Path.stat
    monkeypatch.setattr(
        Path,
        "stat",
        lambda path, **options: os.stat_result(
            (*plain(path, **options)[:10],), {"st_ctime_ns": 1, "st_rdev": plain(path).st_rdev}
        ),
    )
    assert not CalmBoard(link).known, "another board may be plugged in there now"


@pytest.mark.parametrize("scheme", ["tcp", "/dev/null"])
def test_who_reaches_a_board_through_a_gateway_is_not_warned(scheme: str, caplog: pytest.LogCaptureFixture) -> None:
    """The gateway is, when it opens the port; a bridge, and a serial port, has no other who would be."""
    place = "tcp://127.0.0.1:1" if scheme == "tcp" else scheme
    for query, warned in (("", True), ("?to=9", scheme != "tcp")):
        caplog.clear()
        with pytest.raises(LinkError):
            make_driver(f"{place}{query}", "hex7bot").attach()
        assert any("opening it may reset" in line for line in caplog.messages) == warned, query


def test_a_link_on_which_servos_answer_themselves_is_not_warned_of_again(caplog: pytest.LogCaptureFixture) -> None:
    driver = make_driver("sim://so101")
    assert isinstance(driver, BusArm)
    link = driver.bus.link
    # A port that may lead to a board, as one with a CH340 chip does.
    link.url = "tcp://127.0.0.1:1"
    link.may_reset = True  # type: ignore[attr-defined]  # as of links to a port
    for _ in range(2):
        driver.attach()
        driver.detach()
    assert len(caplog.messages) == 1


@pytest.mark.parametrize(
    ("vid", "pid", "warned"),
    [(0x2341, 0x0042, True), (0x1A86, 0x7523, True), (0x1A86, 0x55D3, False), (1, 2, True)],
)
def test_chips_that_only_adapters_have_reset_no_board(
    vid: int, pid: int, warned: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    guess, board, adapter = ports._IDENTITIES.get((vid, pid), ("", False, False))
    found = ports.PortInfo("/dev/null", vid, pid, "", "", guess, board, adapter)
    monkeypatch.setattr(ports, "find_port", lambda device: found)
    assert serial_port.may_reset("/dev/null") is warned

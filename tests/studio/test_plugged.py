"""What is plugged in: likely ports first, with what keeps each from being opened, and what to do."""

from __future__ import annotations

from collections.abc import Sequence

from hexwire.link.diagnose import Finding, Level
from hexwire.link.ports import PortInfo
from hexwire.studio.plugged import Plugged, emulated, find_plugged

_MODEM = PortInfo("/dev/ttyS0", guess="built-in serial port")
_BOARD = PortInfo("/dev/ttyUSB0", 0x1A86, 0x7523, guess="CH340", likely_board=True)
_ADAPTER = PortInfo("/dev/ttyUSB1", 0x1A86, 0x55D3, guess="servo adapter", likely_adapter=True)


def _find(
    *ports: PortInfo,
    owner: str = "",
    findings: Sequence[Finding] = (),
    system: Sequence[Finding] = (),
    hazard: str = "",
) -> list[Plugged]:
    return find_plugged(
        ports=lambda: ports,
        owner=lambda device: owner,
        diagnose=lambda port: findings,
        system=lambda found: system,
        hazard=lambda device: hazard,
    )


def test_likely_ports_come_first_with_the_robots_that_they_may_lead_to() -> None:
    rows = _find(_MODEM, _BOARD, _ADAPTER)
    assert [row.device for row in rows] == ["/dev/ttyUSB0", "/dev/ttyUSB1", "/dev/ttyS0"]
    assert rows[0].robots == ("hex7bot",)
    assert {"so101", "so100"} <= set(rows[1].robots)
    assert rows[2].robots == ()
    assert rows[0].guess == "CH340 (USB 1a86:7523)"
    assert not any(row.obstacle for row in rows)


def test_a_port_in_use_says_by_whom() -> None:
    (row,) = _find(_BOARD, owner="hexwire (pid 7)")
    assert row.obstacle == "it is open in hexwire (pid 7)"
    assert "end that program" in row.advice


def test_a_port_without_permission_says_what_to_do() -> None:
    denied = Finding(
        Level.BAD, "/dev/ttyUSB0", "this user may not open it (crw-rw----)", "sudo usermod -aG dialout ann"
    )
    slow = Finding(Level.BAD, "/dev/ttyUSB0", "latency timer 16 ms", "write 1 to latency_timer")
    (row,) = _find(_BOARD, findings=[slow, denied])
    assert row.obstacle.startswith("this user may not open it")
    assert row.advice == "sudo usermod -aG dialout ann; latency timer 16 ms: write 1 to latency_timer"
    (row,) = _find(_BOARD, findings=[slow])
    assert row.obstacle == ""


def test_a_program_that_meddles_with_usb_ports_is_named() -> None:
    meddler = Finding(Level.BAD, "ModemManager", "talks to every new port", "disable it")
    assert "ModemManager talks to every new port: disable it" in _find(_BOARD, system=[meddler])[0].advice
    assert _find(_MODEM, system=[meddler])[0].advice == ""


def test_what_opening_a_port_may_move_is_said_first_where_it_can_be_opened() -> None:
    slow = Finding(Level.BAD, "/dev/ttyUSB0", "latency timer 16 ms", "write 1 to latency_timer")
    assert _find(_BOARD, findings=[slow], hazard="keep clear")[0].advice.startswith("keep clear; latency timer")
    assert "keep clear" not in _find(_BOARD, owner="hexwire (pid 7)", hazard="keep clear")[0].advice


def test_this_machine_can_be_asked() -> None:
    assert isinstance(find_plugged(), list)
    arms = ["sim://hex7bot", "sim://so101", "sim://so101?any_horns=1", "sim://so100", "sim://so100?any_horns=1"]
    assert [row.device for row in emulated()] == arms
    assert {row.robots[0] for row in emulated()} == {"hex7bot", "so101", "so100"}

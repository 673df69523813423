"""The doctor on a made-up machine, with emulated boards and arms in simulated time."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from click.testing import CliRunner
from tests.bus.bus_bench import make_bus
from tests.drivers.puma_server import served_puma
from tests.ipc.test_mistaken import board_link

from hexwire.cli.doctor import doctor
from hexwire.emulator.faults import FaultPlan
from hexwire.errors import LinkBusyError
from hexwire.link import open as ipc_open
from hexwire.link.base import Link
from hexwire.link.ports import PortInfo
from hexwire.wire.registers import Series

LEGACY = (Series.SEVEN_BOT,) * 4 + (Series.HLS,) * 3
STS = (Series.STS_SMS,)


class Run(NamedTuple):
    rows: list[dict[str, str]]
    status: int
    output: str

    def level(self, start: str) -> list[str]:
        return [row["level"] for row in self.rows if f"{row['about']}: {row['text']}".startswith(start)]

    @property
    def bad(self) -> list[dict[str, str]]:
        return [row for row in self.rows if row["level"] == "bad"]


class Machine:
    """Ports that are there, and what is behind them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
        self.folder = folder
        self.ports: list[PortInfo] = []
        self.links: dict[str, Link] = {}
        self.opened: list[str] = []
        monkeypatch.setattr("hexwire.link.ports.list_ports", lambda: self.ports)
        make = ipc_open.make_link
        monkeypatch.setattr(ipc_open, "make_link", lambda url: self._open(url) or make(url))
        monkeypatch.delenv("HEXWIRE_PORT", raising=False)

    def _open(self, url: str) -> Link | None:
        self.opened.append(url)
        return next((link for device, link in self.links.items() if device in url), None)

    def plug(self, name: str, link: Link | None = None, **options: Any) -> str:
        device = self.folder / name
        device.touch(mode=0o660)
        self.ports.append(PortInfo(str(device), **options))
        if link is not None:
            self.links[str(device)] = link
        return str(device)

    def board(self, *faults: str, dialect: int = 2) -> str:
        link = board_link(*faults, dialect=dialect)
        link.clock.advance(10.0)
        return self.plug("ttyUSB0", link, vid=0xFFFE, pid=0xFFFE, guess="a board", likely_board=True)

    def bus(
        self, ids: Sequence[int] = range(1, 7), series: Sequence[Series] = STS, *faults: str, **more: Any
    ) -> str:
        plan = FaultPlan(faults) if faults else None
        bus, self.device = make_bus(tuple(ids), series, faults=plan, **more)
        bus.close()
        bus.link.set_baud(115200)
        return self.plug("ttyACM0", bus.link, vid=0x1A86, pid=0x55D3, guess="an adapter", likely_adapter=True)

    def run(self, *args: str) -> Run:
        result = CliRunner().invoke(doctor, [*args, "--json"])
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            from hexwire.cli.exits import run

            def again() -> None:
                raise result.exception

            status = run(again)
        else:
            status = result.exit_code
        text = result.stdout[: result.stdout.rindex("]") + 1] if "]" in result.stdout else "[]"
        return Run(json.loads(text), status, result.output)


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Machine:
    return Machine(monkeypatch, tmp_path)


# --- what is healthy is good -------------------------------------------------------------------------------------


def test_a_healthy_board(machine: Machine) -> None:
    machine.board()
    run = machine.run()
    assert (run.status, run.bad) == (0, [])
    assert run.level("servos: all 7 answer") == ["ok"]
    assert run.level("board: hex7bot, dialect 2") == ["ok"]
    assert any("no udev rule" in row["text"] and row["level"] == "hint" for row in run.rows)
    assert any("16 MHz" in row["text"] for row in run.rows)


def test_an_old_board_is_a_hint(machine: Machine) -> None:
    run = machine.run("--port", machine.board(dialect=1))
    assert (run.status, run.bad) == (0, [])
    assert run.level("board: hex7bot, dialect 1") == ["hint"]
    assert run.level("supply: unknown") == ["unknown"]


@pytest.mark.parametrize("robot", ["so100", "so101", "chain"])
@pytest.mark.parametrize("echo", [False, True])
def test_a_healthy_arm_on_an_adapter(machine: Machine, robot: str, echo: bool) -> None:
    run = machine.run("--robot", robot, "--port", machine.bus(echo=echo))
    assert (run.status, run.bad) == (0, [])
    assert run.level("servos: all 6 answer") == ["ok"]
    assert run.level("supply: 7.4 V; the servos need 4.0 to 8.0 V") == ["ok"]
    # Nothing that is about boards.
    assert not any(word in json.dumps(run.rows) for word in ("MHz", "dialect", "flash", "reset"))


def test_a_healthy_seven_bot_without_its_board(machine: Machine) -> None:
    run = machine.run("--robot", "sevenbot", "--port", machine.bus(range(7), LEGACY, baud=115200))
    assert (run.status, run.bad) == (0, [])
    assert run.level("supply: unknown for J1, J2, J3, J4") == ["unknown"]


def test_a_healthy_chain_of_mixed_servos(machine: Machine, tmp_path: Path) -> None:
    kinds = (Series.STS_SMS, Series.SCS, Series.HLS, Series.STS_SMS)
    file = tmp_path / "mixed.toml"
    joint = '[[joints]]\nname = "J{0}"\nservo_id = {0}\nseries = "{1}"\nminimum_deg = -90.0\nmaximum_deg = 90.0\n'
    joints = "".join(joint.format(i, kind.value) for i, kind in enumerate(kinds, 1))
    file.write_text('name = "mixed"\n' + joints)
    run = machine.run("--robot", str(file), "--port", machine.bus(range(1, 5), kinds))
    assert (run.status, run.bad) == (0, [])
    assert run.level("supply: 6.0 to 8.4 V") == ["ok"]


def test_a_healthy_puma260(machine: Machine) -> None:
    with served_puma() as puma:
        run = machine.run("--robot", "puma260", "--port", puma.tcp)
    assert (run.status, run.bad) == (0, [])
    assert run.level("servos: all 6 answer") == ["ok"]
    assert run.level("supply: unknown") == ["unknown"]


# --- which ports are looked at -----------------------------------------------------------------------------------


def test_only_the_port_that_was_named_is_looked_at(machine: Machine) -> None:
    other = machine.board()
    mine = machine.bus()
    run = machine.run("--robot", "so101", "--port", mine)
    assert run.status == 0
    assert other not in json.dumps(run.rows)
    assert all(mine in url for url in machine.opened)


def test_without_a_port_each_is_labelled_and_only_likely_ones_are_spoken_to(machine: Machine) -> None:
    board, adapter = machine.board(), machine.bus()
    strange = machine.plug("ttyS0", guess="built-in serial port")
    run = machine.run()
    assert {row["port"] for row in run.rows if row["about"] != "ModemManager"} == {board, adapter, strange}
    assert {row["port"] for row in run.rows if row["about"] == "servos"} == {board}
    assert all(board in url for url in machine.opened)
    arms = machine.run("--robot", "so101")
    assert {row["port"] for row in arms.rows if row["about"] == "servos"} == {adapter}
    shown = CliRunner().invoke(doctor, []).output
    assert f"ok    {board}: servos: all 7 answer" in shown


@pytest.mark.parametrize(("device", "text"), [("ttyS0", "no likely board"), ("", "no serial port")])
def test_without_a_board_it_says_so(machine: Machine, device: str, text: str) -> None:
    if device:
        machine.plug(device, guess="built-in serial port")
    run = machine.run()
    assert run.status == 0
    assert [row["level"] for row in run.rows if text in row["text"]] == ["hint"]


def test_a_port_by_another_name(machine: Machine, tmp_path: Path) -> None:
    (tmp_path / "by-id").symlink_to(machine.bus())
    machine.links[str(tmp_path / "by-id")] = next(iter(machine.links.values()))
    run = machine.run("--robot", "so101", "--port", str(tmp_path / "by-id"))
    assert run.status == 0
    assert run.level(f"{tmp_path}/by-id: an adapter") == ["ok"]


# --- what is broken is named -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("ids", "faults", "options", "words"),
    [
        ((1, 2, 4, 5, 6), (), {}, "elbow_flex (servo 3) does not answer"),
        ((1, 2, 9, 4, 5, 6), (), {}, "elbow_flex (servo 3) is missing"),
        ((1, 2, 2, 4, 5, 6), (), {}, "several servos seem to share an id"),
        ((1, 1, 1, 1, 1, 1), (), {}, "several servos seem to share an id"),
        (range(1, 7), ("supply:3:3.5",), {}, "supply 3.5 V, too low"),
        (range(1, 7), tuple(f"supply:{i}:12" for i in range(1, 7)), {}, "supply 12.0 V, too high"),
        (range(1, 7), ("hot:3",), {}, "85 deg C, its limit is 70"),
        (range(1, 7), ("overload:3",), {}, "reports overload"),
        (range(1, 7), (), {"baud": 500_000}, "answer at 500000 baud, not at 1000000"),
        ((1,), ("silent:1",), {"echo": True}, "receives only its own echo"),
        ((1,), ("silent:1",), {}, "no servo answers at 1000000 baud"),
    ],
)
def test_an_arm_with_a_fault(
    machine: Machine, ids: Sequence[int], faults: tuple[str, ...], options: dict[str, Any], words: str
) -> None:
    run = machine.run("--robot", "so101", "--port", machine.bus(ids, STS, *faults, **options))
    (bad,) = run.bad
    assert words in bad["text"]
    assert bad["advice"]
    assert run.status == 1


def test_a_board_with_a_silent_and_a_hot_servo(machine: Machine) -> None:
    run = machine.run("--port", machine.board("silent:4", "hot:6"))
    assert run.status == 1
    assert [(row["about"], row["text"]) for row in run.bad] == [
        ("servos", "J5 (servo 4) does not answer"),
        ("J7", "reports temperature, 85 deg C now"),
    ]


def test_a_board_at_another_rate(machine: Machine) -> None:
    link = board_link(board_rate=57_600)
    port = machine.plug("ttyUSB0", link, likely_board=True)
    (bad,) = machine.run("--port", port).bad
    assert bad["text"] == "the board uses 57600 baud"
    assert "--baud 57600" in bad["advice"]


def test_the_other_kind_of_device(machine: Machine) -> None:
    (bad,) = machine.run("--port", machine.bus()).bad
    assert "is a servo bus" in bad["text"]
    (bad,) = machine.run("--robot", "so101", "--port", machine.board()).bad
    assert "is a controller board" in bad["text"]


@pytest.mark.parametrize("baud", [38_400, 250_000, 500_000])
def test_a_servo_bus_at_another_rate_where_a_board_was_meant(machine: Machine, baud: int) -> None:
    (bad,) = machine.run("--port", machine.bus(baud=baud)).bad
    assert f"is a servo bus (servos 1, 2, 3, 4, 5, 6 answer at {baud} baud)" in bad["text"]
    assert f"--robot so101 --baud {baud}, or try `hexwire bus scan --baud {baud}`" in bad["text"]


def test_a_port_in_use(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    port = machine.bus()

    def busy() -> None:
        raise LinkBusyError(f"{port} is in use by cat (pid 7): close that first")

    monkeypatch.setattr(machine.links[port], "open", busy)
    run = machine.run("--robot", "so101", "--port", port)
    assert [row["text"] for row in run.bad] == [f"{port} is in use by cat (pid 7): close that first"]
    assert run.status == 1


def test_a_port_of_somebody_else(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    port = machine.bus()
    monkeypatch.setattr("os.access", lambda *_: False)
    run = machine.run("--robot", "so101", "--port", port)
    (bad,) = run.bad
    assert "may not open it" in bad["text"]
    assert bad["advice"]
    assert (run.status, machine.opened) == (1, [])


@pytest.mark.parametrize("robot", ["hex7bot", "so101"])
def test_no_such_port(machine: Machine, tmp_path: Path, robot: str) -> None:
    run = machine.run("--robot", robot, "--port", str(tmp_path / "ttyNOPE"))
    (bad,) = run.bad
    assert "does not exist" in bad["text"]
    assert (len(run.rows), run.status) == (1, 1)


@pytest.mark.parametrize("args", [("--robot", "nope"), ("--port", "serial://x/y"), ("--port", "what://x")])
def test_invalid_values_are_usage_errors(machine: Machine, args: tuple[str, ...]) -> None:
    run = machine.run(*args)
    assert (run.rows, run.status) == ([], 2)


# --- words -------------------------------------------------------------------------------------------------------


def test_words_name_the_advice_and_fix_writes_the_rule(
    machine: Machine, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    machine.board()
    written: list[list[str]] = []
    monkeypatch.setattr(
        "hexwire.link.diagnose.write_udev_rule", lambda ids: written.append(list(ids)) or tmp_path / "rule"
    )
    shown = CliRunner().invoke(doctor, []).output
    assert 'ATTRS{idVendor}=="fffe"' in shown
    assert "-> " in shown
    assert not written
    assert "wrote" in CliRunner().invoke(doctor, ["--fix"]).output
    assert written == [["fffe:fffe"]]

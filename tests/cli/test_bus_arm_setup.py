from __future__ import annotations

import io
import json
from collections.abc import Callable
from types import SimpleNamespace

import pytest
from click.testing import CliRunner, Result
from tests.setup.test_setting_up import Table, new

from hexwire.cli.main import cli
from hexwire.drivers.stop_memory import StopMemory
from hexwire.emulator.servo import EmulatedServo
from hexwire.link import open as link_open


class Person(io.StringIO):
    """Standard input: somebody who does something at the table before each line is typed."""

    def __init__(self, *acts: Callable[[], object] | str) -> None:
        super().__init__()
        self._acts = list(acts)

    def readline(self, size: int | None = -1) -> str:
        """Return the next word that is typed; the end of the input if there is nothing left to do."""
        if not self._acts:
            return ""
        act = self._acts.pop(0)
        if isinstance(act, str):
            return f"{act}\n"
        act()
        return "\n"

    @property
    def left(self) -> int:
        return len(self._acts)


class SetupCli:
    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.table = Table()
        self.table.bus.close()
        self.monkeypatch = monkeypatch
        monkeypatch.setattr(link_open, "make_link", lambda url: self.table.link)

    def plug(self, *servos: EmulatedServo) -> Callable[[], object]:
        return lambda: self.table.connect(*servos)

    def run(self, person: Person, *words: str) -> Result:
        # The runner replaces the standard input; this is inside of it.
        self.monkeypatch.setattr("hexwire.cli.bus_setup.sys", SimpleNamespace(stdin=person))
        return CliRunner().invoke(cli, ["bus", "setup", *words, "--port", "/dev/ttyTEST"])


def test_an_arm_from_six_new_servos(monkeypatch: pytest.MonkeyPatch) -> None:
    bench, servos = SetupCli(monkeypatch), [new(i) for i in range(6)]
    acts: list[Callable[[], object] | str] = []
    for i in range(6):
        acts.append(bench.plug(*servos[: i + 1]))
        if i < 5:
            acts.append("y")
    person = Person(*acts)
    result = bench.run(person, "so101", "--follower")
    assert result.exit_code == 0, result.output
    assert person.left == 0
    assert [servo.registers.stored("id") for servo in servos] == [6, 5, 4, 3, 2, 1]
    assert "connect the servo of gripper: alone, or with those that are set up" in result.stderr
    assert "in the gripper; it moves the jaw or trigger" in result.stderr
    assert "(6) gripper" in result.stderr
    assert "gears 1:345" in result.stderr
    assert "found servo 1 at 1000000 baud: sts3215, firmware 3.10, made for 7.4 V, supply 7.4 V" in result.stderr
    assert "gripper becomes servo 6 at 1000000 baud. Right?" in result.stderr
    assert "so101 is set up; next: `hexwire bus calibrate so101`" in result.stdout


def test_a_servo_that_is_connected_from_the_beginning_is_asked_about_after_the_picture(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bench, servo = SetupCli(monkeypatch), new(0)
    bench.plug(servo)()
    result = bench.run(Person("y", "q"), "so101")
    picture, question = result.stderr.index("(6) gripper"), result.stderr.index("gripper becomes servo 6")
    assert picture < question
    assert result.stderr.count("(6) gripper") == 1
    assert servo.servo_id == 6


def test_an_arm_is_a_leader_or_a_follower(monkeypatch: pytest.MonkeyPatch) -> None:
    result = SetupCli(monkeypatch).run(Person(), "so101", "--leader", "--follower")
    assert result.exit_code == 2
    assert "--leader and --follower contradict each other" in result.stderr


def test_it_can_be_ended_and_resumed(monkeypatch: pytest.MonkeyPatch) -> None:
    bench, servos = SetupCli(monkeypatch), [new(i) for i in range(6)]
    first = bench.run(Person(bench.plug(servos[0]), "y", "q"), "so100", "--yes")
    assert first.exit_code == 1
    assert "not finished: wrist_roll, wrist_flex, elbow_flex, shoulder_lift, shoulder_pan" in first.stderr
    acts = [bench.plug(*servos[: i + 1]) for i in range(1, 6)]
    second = bench.run(Person(*acts), "so100", "--yes", "--json")
    assert second.exit_code == 0, second.output
    assert "gripper is set up: servo 6, sts3215 3.10" in second.stderr
    rows = json.loads(second.stdout)
    assert [(row["joint"], row["id"], row["done"]) for row in rows][-1] == ("shoulder_pan", 1, True)
    assert rows[0]["model"] == "sts3215"
    third = bench.run(Person(), "so100")
    assert third.exit_code == 0, third.output


def test_mistakes_at_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    bench, one, two = SetupCli(monkeypatch), new(), new(3)
    high = new(1)
    high.supply = 12.0
    person = Person(
        bench.plug(one, two),  # two new ones
        bench.plug(high),  # the wrong supply
        bench.plug(one),
        "n",  # not this one
        bench.plug(two),
        "y",
        "q",
    )
    result = bench.run(person, "so101")
    assert "several servos have id 1: unplug all but one of them" in result.stderr
    assert "above its limit of 8.0 V" in result.stderr
    assert "unplug it, connect the right one" in result.stderr
    assert (high.servo_id, one.servo_id, two.servo_id) == (1, 1, 6)
    assert result.exit_code == 1


def test_a_change_that_fails_is_reported_and_the_servo_is_found_again(monkeypatch: pytest.MonkeyPatch) -> None:
    bench, servo = SetupCli(monkeypatch), new()
    receive = servo.receive
    servo.receive = lambda packet, now: (  # type: ignore[method-assign]
        receive(packet, now) if servo.servo_id == 1 else None
    )

    def heal() -> None:
        servo.receive = receive  # type: ignore[method-assign]

    result = bench.run(Person(bench.plug(servo), "y", heal, "q"), "so101")
    assert "error: servo 1 answers neither to 1 nor to 6" in result.stderr
    assert "gripper is set up: servo 6" in result.stderr


def test_one_joint_after_a_repair(monkeypatch: pytest.MonkeyPatch) -> None:
    bench, servo = SetupCli(monkeypatch), new(servo_id=5)
    result = bench.run(Person(bench.plug(servo), "y"), "so101", "--joint", "elbow_flex")
    assert result.exit_code == 0, result.output
    assert servo.registers.stored("id") == 3
    assert "elbow_flex is set up" in result.stdout


def test_a_warning_is_asked_about_even_with_yes(monkeypatch: pytest.MonkeyPatch) -> None:
    bench, servo = SetupCli(monkeypatch), new(max_voltage=140)
    servo.supply = 12.0
    result = bench.run(Person(bench.plug(servo), "q"), "so101", "--leader", "--yes")
    assert "warning: a leader arm has servos for 7.4 V, and this one is made for 12 V" in result.stderr
    assert servo.servo_id == 1


def test_nobody_at_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = SetupCli(monkeypatch)
    result = bench.run(Person(), "so101", "--yes")
    assert result.exit_code == 2
    assert "needs somebody at the arm" in result.stderr
    assert bench.run(Person(), "so101", "--series", "sts").exit_code == 2
    assert bench.run(Person(), "hex7bot").exit_code == 2
    monkeypatch.setattr(StopMemory, "stopped", True)
    assert "the arm is stopped" in bench.run(Person(), "so101").stderr

"""Things broken on an emulated bus, one at a time: the cause is named, in one line, with what to do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pytest
from tests.bus.bus_bench import BusLink, make_bus
from tests.motion.arms import at_rest

from hexwire.bus.servo_bus import ServoBus
from hexwire.drivers.arm_file import load_profile
from hexwire.drivers.checkup import (
    examine_bus,
    explain_chatter,
    explain_missing,
    explain_silence,
    judge_traffic,
)
from hexwire.drivers.values import JointProbe, ProbeReport
from hexwire.emulator.bus_device import BusDevice, make_servos
from hexwire.emulator.faults import FaultPlan
from hexwire.emulator.serve import FakeClock
from hexwire.link.diagnose import Finding, Level
from hexwire.model.state import JointFlag
from hexwire.wire.registers import Series

ARM = load_profile("so101").model
ELBOW = ARM.joint("elbow_flex")
CABLE = "check the cable"


def bus(ids: Sequence[int] = range(1, 7), **options: object) -> ServoBus:
    return make_bus(tuple(ids), **options)[0]  # type: ignore[arg-type]


def at_rates(*rates: int) -> ServoBus:
    servos = make_servos([Series.STS_SMS], range(1, 1 + len(rates)), baud=rates)
    host = [1_000_000]
    link = BusLink(BusDevice(servos, paced=True, host_baud=lambda: host[0]))
    link.rates = host
    opened = ServoBus(link)
    opened.open()
    return opened


class Foreign:
    """A device with a protocol of its own."""

    def __init__(self, *, chatter: bytes = b"", answer: bytes = b"") -> None:
        self.chatter, self.answer = chatter, answer
        self._next, self._out = 0.0, b""
        self.now = 0.0

    def receive(self, data: bytes, now: float) -> None:
        self._out += self.answer

    def step(self, now: float) -> None:
        self.now = now
        if self.chatter and now >= self._next:
            self._out += self.chatter
            self._next = now + 0.2

    def data_to_send(self) -> bytes:
        out, self._out = self._out, b""
        return out

    def next_event_time(self) -> float | None:
        return self._next if self.chatter else None

    def reset(self, now: float) -> None:
        return None


def foreign(**options: bytes) -> ServoBus:
    link = BusLink(Foreign(**options), FakeClock())
    link.rates = [1_000_000]
    opened = ServoBus(link)
    opened.open()
    return opened


def only(findings: list[Finding]) -> Finding:
    (finding,) = findings
    assert finding.level is Level.BAD
    assert "\n" not in finding.text + finding.advice
    return finding


def test_nobody_is_missing() -> None:
    opened = bus()
    assert explain_missing(opened, ARM, []) == []
    assert [row.level for row in judge_traffic(opened, ARM)] == [Level.OK]


def test_one_servo_is_missing() -> None:
    found = only(explain_missing(bus((1, 2, 4, 5, 6)), ARM, [ELBOW]))
    assert found.text == "elbow_flex (servo 3) does not answer"
    assert "cable" in found.advice


def test_a_servo_that_is_missing_is_told_once_of_a_whole_arm() -> None:
    probes = tuple(
        JointProbe(joint.name, joint.servo_id, "sts_sms", joint.name != "elbow_flex") for joint in ARM.joints
    )
    report = ProbeReport("so101", joints=probes)
    state = at_rest(ARM, (0.0,) * 6)
    flags = tuple(int(JointFlag.SILENT) if name == "elbow_flex" else 0 for name in state.names)
    findings = examine_bus(bus((1, 2, 4, 5, 6)), ARM, report, replace(state, flags=flags, voltage=(7.4,) * 6))
    assert [row.text for row in findings if row.level is Level.BAD] == ["elbow_flex (servo 3) does not answer"]


def test_one_has_a_wrong_id() -> None:
    found = only(explain_missing(bus((1, 2, 9, 4, 5, 6)), ARM, [ELBOW]))
    assert found.about == "id 9"
    assert "elbow_flex (servo 3) is missing" in found.text
    assert "`hexwire bus set-id 9 3`" in found.advice


@pytest.mark.parametrize(("ids", "missing"), [((1, 2, 2, 4, 5, 6), [ELBOW]), ((1, 2, 2, 3, 4, 5, 6), [])])
def test_two_have_one_id(ids: tuple[int, ...], missing: list[object]) -> None:
    found = only(explain_missing(bus(ids), ARM, missing))  # type: ignore[arg-type]
    assert found.about == "id 2"
    assert "several servos" in found.text
    assert ("elbow_flex" in found.text) is bool(missing)
    assert "set-id" in found.advice


def test_one_is_at_another_rate() -> None:
    opened = at_rates(1_000_000, 1_000_000, 500_000, 1_000_000, 1_000_000, 1_000_000)
    found = only(explain_missing(opened, ARM, [ELBOW]))
    assert found.text == "servo 3 answers at 500000 baud, not at 1000000"
    assert "`hexwire bus set-baud 3 1000000 --baud 500000`" in found.advice
    assert opened.timing.baud == 1_000_000


@pytest.mark.parametrize("rate", [500_000, 250_000, 128_000, 115_200, 76_800, 57_600, 38_400])
def test_all_are_at_another_rate(rate: int) -> None:
    found = only(explain_silence(at_rates(*[rate] * 6), ARM))
    assert found.text == f"servos 1, 2, 3, 4, 5, 6 answer at {rate} baud, not at 1000000"
    assert f"--baud {rate}" in found.advice


def test_another_arm() -> None:
    found = only(explain_silence(bus((11, 12)), ARM))
    assert found.text.startswith("servos 11, 12 answer, but none of so101")


@pytest.mark.parametrize("echo", [False, True])
def test_nothing_behind_the_adapter(echo: bool) -> None:
    found = only(explain_silence(bus((1,), echo=echo, faults=FaultPlan(["silent:1"])), ARM))
    assert ("receives only its own echo" in found.text) is echo
    assert "supply on" in found.advice
    assert CABLE in found.advice


def test_an_echo_is_reported_but_is_not_a_fault() -> None:
    opened = bus(echo=True)
    assert explain_missing(opened, ARM, []) == []
    rows = judge_traffic(opened, ARM)
    assert {row.level for row in rows} == {Level.OK}
    assert "echoes what is sent" in rows[0].text


@pytest.mark.parametrize("options", [{"chatter": b"$GPGGA,1235\r\n"}, {"answer": b"ERROR\r\n"}])
def test_another_device(options: dict[str, bytes]) -> None:
    found = only(explain_silence(foreign(**options), ARM))
    assert "'$GPGGA" in found.text or "'ERROR'" in found.text
    assert "another device" in found.advice


def test_a_quiet_line_does_not_chatter() -> None:
    assert explain_chatter(bus().link) is None


def test_lost_answers_are_counted() -> None:
    opened = bus(faults=FaultPlan(["bus.flip:0.4"], seed=3))
    (row,) = judge_traffic(opened, ARM)
    assert row.level is Level.BAD
    assert "bus stress" in row.advice

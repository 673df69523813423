"""The set-up of an arm on emulated servos, with everything that goes wrong at a bench."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pytest
from tests.bus.bus_bench import BusLink
from tests.few import few

from hexwire.bus.servo_bus import ServoBus
from hexwire.drivers.arm_file import load_profile
from hexwire.emulator.bus_device import BusDevice
from hexwire.emulator.servo import EmulatedServo
from hexwire.errors import ServoError, UsageError
from hexwire.setup.arm_setup import ArmSetup, StepKind
from hexwire.setup.setting_up import assign, look
from hexwire.wire.registers import Series

SO101 = load_profile("so101").model
MILLION = 1_000_000
CODES = {rate: code for code, rate in Series.STS_SMS.baud_codes.items()}


class Table:
    """A bench with an adapter, to which servos are connected by hand."""

    def __init__(self, *, echo: bool = False) -> None:
        self.rates = [MILLION]
        self.device = BusDevice([], paced=True, host_baud=lambda: self.rates[0], echo=echo)
        self.link = BusLink(self.device)
        self.link.rates = self.rates
        self.bus = ServoBus(self.link)
        self.bus.open()

    def connect(self, *servos: EmulatedServo) -> None:
        """Connect these servos and no others."""
        self.device.wire.servos[:] = servos


def new(place: int = 0, *, servo_id: int = 1, baud: int = MILLION, **settings: int) -> EmulatedServo:
    stored = {"baud_code": CODES[baud], **settings}
    return EmulatedServo(Series.STS_SMS, servo_id, position=1500 + 137 * place, settings=stored, start=1000.0)


def once(table: Table, plan: ArmSetup) -> None:
    step = plan.step
    assert step.kind is StepKind.ASSIGN, step
    assign(table.bus, plan, step)


@pytest.mark.parametrize("echo", [False, True])
def test_six_new_servos_become_an_arm(echo: bool) -> None:
    table, plan = Table(echo=echo), ArmSetup(SO101, MILLION)
    chain: list[EmulatedServo] = []
    for place in range(6):
        chain.append(new(place))
        table.connect(*chain)
        look(table.bus, plan)
        if place < 5:
            once(table, plan)
    look(table.bus, plan)
    assert plan.step.kind is StepKind.DONE
    assert [servo.registers.stored("id") for servo in chain] == [6, 5, 4, 3, 2, 1]
    assert [servo.registers.get("lock") for servo in chain] == [1] * 6
    assert plan.remarks == ()


@pytest.mark.parametrize(
    "odd",
    [
        new(servo_id=1, baud=115_200),
        new(servo_id=200),
        new(servo_id=77, baud=500_000),
        new(servo_id=6, baud=57_600),
    ],
)
def test_a_servo_with_any_id_and_rate_is_found_and_changed(odd: EmulatedServo) -> None:
    table, plan = Table(), ArmSetup(SO101, MILLION)
    table.connect(odd)
    look(table.bus, plan)
    once(table, plan)
    assert (odd.registers.stored("id"), odd.registers.stored("baud_code")) == (6, 0)
    assert table.bus.timing.baud == MILLION


def test_an_odd_id_among_others_needs_a_search_everywhere() -> None:
    table, plan = Table(), ArmSetup(SO101, MILLION)
    table.connect(new(0, servo_id=6), new(1, servo_id=200))
    look(table.bus, plan)
    assert plan.step.kind is StepKind.CONNECT
    look(table.bus, plan, everywhere=True)
    once(table, plan)
    assert table.device.wire.servos[1].servo_id == 5


@pytest.mark.parametrize("second", [new(3), new(3, baud=500_000), new(3, servo_id=9)])
def test_two_servos_by_mistake_are_detected_before_anything_is_written(second: EmulatedServo) -> None:
    table, plan = Table(), ArmSetup(SO101, MILLION)
    first = new()
    table.connect(first, second)
    before = [bytes(servo.registers.read(0, 40)) for servo in (first, second)]
    look(table.bus, plan)
    if plan.step.kind is StepKind.ASSIGN:
        # The other one answers at another rate only: it is not changed, and found next.
        once(table, plan)
        look(table.bus, plan)
        assert (plan.step.kind, plan.step.servo and plan.step.servo.baud) == (StepKind.ASSIGN, 500_000)
        return
    assert plan.step.kind is StepKind.SEPARATE
    with pytest.raises(UsageError, match="no servo to set up"):
        assign(table.bus, plan, plan.step)
    assert [bytes(servo.registers.read(0, 40)) for servo in (first, second)] == before


def test_a_servo_whose_new_id_is_taken_at_the_arms_rate_is_not_brought_there() -> None:
    table, plan = Table(), ArmSetup(SO101, MILLION)
    slow = new(baud=115_200)
    table.connect(slow)
    look(table.bus, plan)
    hidden = new(2, servo_id=6)
    table.connect(slow, hidden)
    with pytest.raises(ServoError, match="another servo has id 6 at 1000000 baud: unplug one"):
        assign(table.bus, plan, plan.step)
    assert (slow.servo_id, slow.baud, hidden.servo_id, hidden.baud) == (1, 115_200, 6, MILLION)


def wrong_supply(volts: float) -> EmulatedServo:
    servo = new()
    servo.supply = volts
    return servo


@pytest.mark.parametrize(("volts", "said"), [(12.1, "above its limit of 8.0 V"), (3.5, "below its limit of 4.0 V")])
def test_nothing_is_stored_with_a_wrong_supply(volts: float, said: str) -> None:
    table, plan = Table(), ArmSetup(SO101, MILLION)
    table.connect(wrong_supply(volts))
    look(table.bus, plan)
    assert said in plan.step.blocked
    with pytest.raises(UsageError, match=f"servo 1 is not changed: .*{said}"):
        assign(table.bus, plan, plan.step)


def test_firmware_and_voltage_classes_of_the_whole_arm() -> None:
    table, plan = Table(), ArmSetup(SO101, MILLION)
    servos = [
        EmulatedServo(
            Series.STS_SMS,
            i,
            position=1000 + 99 * i,
            firmware=(3, 9) if i == 2 else None,
            settings={"max_voltage": 140 if i == 3 else 80},
            start=1000.0,
        )
        for i in range(1, 7)
    ]
    table.connect(*servos)
    look(table.bus, plan)
    words = "\n".join(plan.remarks)
    assert "shoulder_lift: firmware 3.9 is older than 3.10" in words
    assert "elbow_flex: made for 12 V: with 7.4 V it is slower and weaker" in words
    assert "different firmware (3.10, 3.9): LeRobot refuses such an arm" in words
    assert "servos for 12 V and for 7.4 V are mixed" in words


class Cut:
    """Cuts the supply of all servos before the packet with a number arrives."""

    def __init__(self, table: Table, at: int) -> None:
        self.table, self.at, self.count = table, at, 0
        self._receive: Callable[[bytes, float], None] = table.device.receive
        table.device.receive = self.receive  # type: ignore[method-assign]

    def receive(self, data: bytes, now: float) -> None:
        self.count += 1
        if self.count == self.at:
            for servo in self.table.device.wire.servos:
                servo.power_cycle(now)
        if self.count < self.at:
            self._receive(data, now)

    def end(self) -> None:
        self.table.device.receive = self._receive  # type: ignore[method-assign]


def finish(table: Table, servos: Sequence[EmulatedServo]) -> None:
    """Resume with a new program that knows nothing."""
    table.connect(*servos)
    plan = ArmSetup(SO101, MILLION)
    look(table.bus, plan)
    if plan.step.kind is StepKind.ASSIGN:
        once(table, plan)
    assert "gripper" in plan.done


@pytest.mark.slow
def test_a_power_cut_at_any_packet_loses_no_servo() -> None:
    cuts = 0
    for at in range(1, 200):
        table, plan, servo = Table(), ArmSetup(SO101, MILLION), new(baud=115_200)
        table.connect(servo)
        look(table.bus, plan)
        step, cut = plan.step, Cut(table, at)
        try:
            assign(table.bus, plan, step)
        except ServoError:
            cuts += 1
        cut.end()
        finish(table, [servo])
        assert (servo.registers.stored("id"), servo.registers.stored("baud_code")) == (6, 0)
        if cut.count < at:
            break
    else:
        raise AssertionError("the change never came to its end")
    assert cuts > 20


@few("lost", range(1, 40, 3), 1, 13, 25)
def test_a_servo_that_falls_silent_for_a_while_is_found_again(lost: int) -> None:
    table, plan, servo = Table(), ArmSetup(SO101, MILLION), new(baud=500_000)
    table.connect(servo)
    look(table.bus, plan)
    receive, count = servo.receive, [0]

    def mute(packet: object, now: float) -> bytes | None:
        count[0] += 1
        answer = receive(packet, now)  # type: ignore[arg-type]
        return None if lost <= count[0] < lost + 25 else answer

    servo.receive = mute  # type: ignore[method-assign, assignment]
    try:
        assign(table.bus, plan, plan.step)
    except ServoError:
        servo.receive = receive  # type: ignore[method-assign]
        finish(table, [servo])
    assert (servo.registers.stored("id"), servo.registers.stored("baud_code")) == (6, 0)


def test_a_servo_that_stays_silent_afterwards_is_not_called_done() -> None:
    table, plan, servo = Table(), ArmSetup(SO101, MILLION), new()
    table.connect(servo)
    look(table.bus, plan)
    receive = servo.receive
    servo.receive = lambda packet, now: (  # type: ignore[method-assign]
        receive(packet, now) if servo.servo_id == 1 else None
    )
    with pytest.raises(ServoError, match="answers neither to 1 nor to 6"):
        assign(table.bus, plan, plan.step)
    assert plan.done == {}


def test_a_link_without_a_rate_looks_only_there(monkeypatch: pytest.MonkeyPatch) -> None:
    table, plan = Table(), ArmSetup(SO101, MILLION)
    monkeypatch.delattr(BusLink, "set_baud")
    monkeypatch.delattr(BusLink, "baud")
    table.bus.close()
    table.bus = ServoBus(table.link)
    table.bus.open()
    assert table.bus.timing.baud == 0
    table.connect(new())
    look(table.bus, plan)
    once(table, plan)
    assert table.device.wire.servos[0].servo_id == 6
    table.connect()
    look(table.bus, plan)
    assert plan.step.kind is StepKind.CONNECT

from __future__ import annotations

import math
import threading
import time
from pathlib import Path

import pytest
from tests.bus.bus_bench import make_bus

from hexwire.bus.setup import scan
from hexwire.drivers.stop_memory import StopMemory
from hexwire.drivers.values import StopMode
from hexwire.emulator.bus_device import BusDevice
from hexwire.errors import DeviceError, HexwireError, LeaseError, StoppedError, UsageError
from hexwire.setup.servo_bench import Job, ServoBench
from hexwire.setup.servo_wave import WaveEnd, one_servo, run_wave, standing
from hexwire.wire.registers import Series

ALL = (Series.STS_SMS, Series.HLS, Series.SCS)


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def make(*, known: bool = True, series: tuple[Series, ...] = ALL) -> tuple[ServoBench, BusDevice, Clock]:
    bus, device = make_bus((1, 2, 3), series, paced=len(series) == 1)
    clock = Clock()
    bench = ServoBench(bus, clock=clock)
    bench.servo_ids = (1, 2, 3) if known else ()
    return bench, device, clock


def test_torque_holds_where_the_servo_is() -> None:
    bench, device, _ = make()
    for servo in device.wire.servos:
        servo.registers.put("goal_position", 500)
    before = [servo.motion.position for servo in device.wire.servos]
    assert bench.torque(True, (1, 2, 3)) == (1, 2, 3)
    bench.bus.pause(1.0)
    for servo, there in zip(device.wire.servos, before, strict=True):
        assert servo.torque_on
        assert servo.motion.position == pytest.approx(there, abs=3)
    assert bench.torque(False, (2,)) == (2,)
    assert [servo.torque_on for servo in device.wire.servos] == [True, False, True]


@pytest.mark.parametrize("mode", list(StopMode))
def test_a_stop_reaches_every_servo(mode: StopMode) -> None:
    bench, device, _ = make()
    bench.torque(True, (1, 2))
    for servo_id in (1, 2):
        goal = 100 if bench.bus.series_of(servo_id) is Series.SCS else 3500
        bench.bus.write_raw(servo_id, "goal_speed", 20)
        bench.bus.write_raw(servo_id, "goal_position", goal)
    bench.bus.pause(0.2)
    there = [servo.motion.position for servo in device.wire.servos]
    assert bench.stop("enough", mode) == ()
    bench.bus.pause(1.0)
    for servo, position in zip(device.wire.servos, there, strict=True):
        assert servo.motion.position == pytest.approx(position, abs=30)
        held = servo.servo_id != 3 and mode is StopMode.HOLD
        assert servo.torque_on is held
    assert (bench.stopped, bench.why_stopped, bench.bus.epochs.number >= 1) == (True, "enough", True)
    assert not device.wire[3].torque_on, "a stop gives no servo torque"


def test_while_stopped_nothing_acts_until_resume() -> None:
    bench, device, _ = make()
    bench.stop("enough")
    with pytest.raises(StoppedError):
        bench.torque(True, (1,))
    with pytest.raises(StoppedError), bench.working("a wave", acts=True):
        pass
    with bench.working("a search"):
        assert bench.bus.ping(1).ok
    assert bench.torque(False, (1,)) == (1,)
    bench.resume()
    assert (bench.stopped, bench.why_stopped) == (False, "")
    assert bench.torque(True, (1,)) == (1,)
    assert device.wire[1].torque_on


def test_a_stop_ends_a_wave_at_once_and_the_servo_holds() -> None:
    bench, device, _ = make(series=(Series.STS_SMS,))
    end = WaveEnd()
    clock = bench.bus.link.clock  # type: ignore[attr-defined]
    with bench.working("a wave", acts=True) as job, one_servo(bench.bus, 1, 0.5) as arm:
        joint = standing(arm)
        arm.torque(True)
        calls = iter(range(1000))

        def go_on() -> bool:
            if next(calls) == 25:
                stopper = threading.Thread(target=bench.stop, args=("tab 2 stopped it",))
                stopper.start()
                stopper.join(30)
            return job.go_on()

        with pytest.raises(HexwireError, match="stopped"):
            run_wave(
                arm,
                joint,
                lambda t: 0.4 * t,
                5.0,
                end,
                go_on=lambda: go_on() or True,
                clock=clock,
                sleep=clock.advance,
            )
        assert job.ended == "tab 2 stopped it"
    assert len(end.samples) <= 26
    there = device.wire[1].motion.position
    bench.bus.pause(2.0)
    assert device.wire[1].motion.position == pytest.approx(there, abs=3)
    assert device.wire[1].torque_on


def test_a_stop_during_a_search_waits_until_the_servos_can_hear_it() -> None:
    bench, device, _ = make(series=(Series.STS_SMS,))
    bench.torque(True, (1,))
    started, ended = threading.Event(), []

    def progress(baud: int, servo_id: int, found: int) -> None:
        if baud == 115_200 and servo_id == 5:
            assert not bench.readable
            started.set()
        job.tell(f"{baud}")

    def stop() -> None:
        started.wait(30.0)
        ended.append(bench.stop("enough"))

    stopper = threading.Thread(target=stop)
    stopper.start()
    with bench.working("a search", changes_rate=True) as job:

        def search() -> None:
            for _ in range(1000):
                scan(bench.bus, bauds=(1_000_000, 115_200), ids=range(8), progress=progress)

        with pytest.raises(DeviceError, match="a search has ended: enough"):
            search()
    stopper.join(30)
    assert ended == [()]
    assert bench.bus.timing.baud == 1_000_000
    assert device.wire[1].torque_on
    assert bench.readable


def test_one_job_at_a_time() -> None:
    bench, _, _ = make()
    with bench.working("a stress test") as job:
        assert bench.job is job
        assert bench.readable
        with pytest.raises(UsageError, match="a stress test is under way"), bench.working("a search"):
            pass
        bench.cancel()
        assert (job.go_on(), job.ended) == (False, "cancelled")
        with pytest.raises(DeviceError, match="cancelled"):
            job.tell("a step")
    assert bench.job is None
    bench.cancel()
    with bench.working("a search") as job:
        job.tell("a step", 0.5)
        assert (job.told, job.share, job.go_on()) == ("a step", 0.5, True)
    assert math.isnan(Job("x").share)


def test_one_has_control_and_a_job_ends_with_it() -> None:
    bench, _, clock = make()
    with pytest.raises(LeaseError):
        bench.need_control(0)
    mine = bench.take("tab 1").key
    bench.need_control(mine)
    assert bench.take("tab 1", key=mine).key == mine
    with pytest.raises(LeaseError):
        bench.take("tab 2")
    with bench.working("a wave") as job:
        theirs = bench.take("tab 2", force=True).key
        assert job.ended == "tab 2 took control"
    with pytest.raises(LeaseError):
        bench.need_control(mine)
    with pytest.raises(LeaseError):
        bench.beat(mine)
    bench.leave(mine)
    assert bench.holder is not None
    clock.now += 4.0
    bench.beat(theirs)
    clock.now += 4.0
    bench.need_control(theirs)
    with bench.working("a wave") as job:
        bench.leave(theirs)
        assert job.ended == "control was given back"
    assert bench.holder is None
    again = bench.take("tab 3").key
    clock.now += 6.0
    assert bench.holder is None
    with pytest.raises(LeaseError):
        bench.need_control(again)


def test_what_is_held_ends_with_a_stop() -> None:
    bench, _, _ = make()
    entry = bench.hold_to_run.begin("tab 1", 1)
    assert entry is not None
    bench.stop("enough")
    assert entry.ended == "enough"


def test_an_unconfirmed_stop_names_the_servos() -> None:
    bench, device, _ = make()
    bench.torque(True, (1, 2, 3))
    device.wire.servos = [servo for servo in device.wire.servos if servo.servo_id != 2]
    assert bench.stop("enough") == (2,)
    device.wire.servos = []
    with pytest.raises(HexwireError):
        bench.stop("again")
    assert bench.stopped


def test_a_stop_is_kept_for_the_next_program(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    kept: list[bool] = [False]
    monkeypatch.setattr(StopMemory, "stopped", property(lambda self: kept[0]))
    monkeypatch.setattr(StopMemory, "remember", lambda self: kept.__setitem__(0, True))
    monkeypatch.setattr(StopMemory, "forget", lambda self: kept.__setitem__(0, False))
    bench, _, _ = make(known=False)
    assert bench.stop("enough") == ()
    assert kept == [True]
    other = ServoBench(bench.bus)
    assert (other.stopped, other.why_stopped) == (True, "stopped by another program of this user")
    other.resume()
    assert kept == [False]
    fresh, _, _ = make()
    assert not fresh.stopped


def test_shutdown_ends_the_job() -> None:
    bench, _, _ = make()
    entered = threading.Event()

    def work() -> None:
        with bench.working("a stress test") as job:
            entered.set()
            while job.go_on():
                pass

    worker = threading.Thread(target=work)
    worker.start()
    entered.wait(30.0)
    bench._clock = time.monotonic
    bench.shutdown()
    worker.join(30)
    assert not worker.is_alive()
    assert bench.job is None


def test_shutdown_waits_two_seconds_for_a_job_that_does_not_end() -> None:
    bench, _, clock = make()

    def tick() -> float:
        clock.now += 0.25
        return clock.now

    bench._clock = tick
    with bench.working("a stress test") as job:
        bench.shutdown()
        assert job.ended == "the bus is closed"
    assert clock.now - 100.0 == pytest.approx(2.0, abs=0.5)

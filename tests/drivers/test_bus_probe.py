from __future__ import annotations

from tests.bus.bus_bench import lose_reads, make_bus

from hexwire.drivers.bus_arm import probe_joint
from hexwire.emulator.faults import FaultPlan
from hexwire.model.arm import JointModel
from hexwire.model.calibration import Calibration, JointCalibration
from hexwire.wire.registers import Series


def joint(series: str, servo_id: int = 1) -> JointModel:
    return JointModel("a", servo_id, series, 0, 1, 0.0, 0.001, -9.0, 9.0, 9.0)


def test_a_servo_says_who_it_is_and_what_it_stands() -> None:
    bus, _ = make_bus((1,))
    probe = probe_joint(bus, joint("sts_sms"))
    assert (probe.name, probe.series, probe.present, probe.note) == ("a", "sts_sms", True, "")
    assert (probe.supply, probe.max_temperature) == ((4.0, 8.0), 70.0)
    assert "sts3215" in probe.model


def test_a_silent_servo_is_missing() -> None:
    bus, _ = make_bus((1,), faults=FaultPlan(["silent:1"]))
    assert not probe_joint(bus, joint("sts_sms")).present


def test_a_servo_of_another_series() -> None:
    bus, _ = make_bus((1,), (Series.HLS,))
    assert probe_joint(bus, joint("sts_sms")).note == "answers as hls, the arm's file says sts_sms"


def test_an_offset_that_is_not_the_calibrated_one() -> None:
    bus, _ = make_bus((1,))
    calibration = Calibration("arm", "", (JointCalibration("a", 1, 2000, 1500, 2600, 1, 77),))
    note = probe_joint(bus, joint("sts_sms"), calibration).note
    assert note == "its offset is 0 but was 77 at calibration: calibrate again"


def test_an_offset_that_was_not_read_is_not_another_one() -> None:
    bus, device = make_bus((1,))
    lose_reads(device.wire[1], "position_offset")
    calibration = Calibration("arm", "", (JointCalibration("a", 1, 2000, 1500, 2600, 1, 77),))
    assert probe_joint(bus, joint("sts_sms"), calibration).note == ""


def test_a_legacy_servo_tells_no_ratings() -> None:
    bus, _ = make_bus((1,), (Series.SEVEN_BOT,))
    probe = probe_joint(bus, joint("seven_bot"))
    assert (probe.present, probe.supply, probe.max_temperature) == (True, None, None)

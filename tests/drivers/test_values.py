from __future__ import annotations

from dataclasses import replace

from hexwire.drivers.values import JointProbe, ProbeReport, Signal, StopCause, StopLatch, StopMode

REPORT = ProbeReport("a", "b", 2, "", None, (), False, (), {})


def test_missing_joints_of_a_probe() -> None:
    joints = (JointProbe("J1", 0, "hls", True), JointProbe("J2", 1, "hls", False))
    assert replace(REPORT, joints=joints).missing == ("J2",)


def test_the_numbers_that_programs_rely_on() -> None:
    assert [(s.name, s.value) for s in Signal] == [
        ("STOP", 1),
        ("STOP_TORQUE_OFF", 2),
        ("RESUME", 3),
        ("TORQUE_ON", 4),
        ("TORQUE_OFF", 5),
    ]
    assert (StopMode.HOLD, StopMode.TORQUE_OFF) == (0, 1)


def test_remarks_of_a_joint() -> None:
    assert JointProbe("J1", 0, "hls", True, "is hls", "hls 3.10").remarks == "is hls, hls 3.10"
    assert JointProbe("J1", 0, "hls", True).remarks == ""


def test_robots_of_one_kind() -> None:
    assert REPORT.same_kind(replace(REPORT, link="elsewhere", boot_id=7))
    assert not REPORT.same_kind(replace(REPORT, dialect=1))
    assert not REPORT.same_kind(replace(REPORT, robot="another"))


def test_a_latch_is_stopped_where_something_stopped_it() -> None:
    assert [cause for cause in StopCause if not StopLatch(cause).stopped] == [StopCause.NONE]


def test_only_dialect_1_is_the_chapters() -> None:
    assert [replace(REPORT, dialect=dialect).chapter for dialect in (0, 1, 2)] == [False, True, False]

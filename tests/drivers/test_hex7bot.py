from __future__ import annotations

import itertools
import math
import threading
import time

import pytest
from tests.drivers.arms import Arm
from tests.ipc.channels import open_channel

from hexwire.drivers.base import Signal, StopMode
from hexwire.drivers.board1 import Board1
from hexwire.drivers.board2 import Board2
from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.drivers.timed_path import TimedPoint
from hexwire.emulator.board import make_hex7bot_board
from hexwire.emulator.faults import FaultPlan
from hexwire.errors import (
    CommandRefusedError,
    LimitError,
    LinkLostError,
    NotSupportedError,
    PreemptedError,
    ReplyTimeoutError,
    StoppedError,
    UsageError,
)
from hexwire.ipc.handle import IpcHandle
from hexwire.ipc.session import Session
from hexwire.link.memory import memory_pair
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.state import JointState, JointTarget
from hexwire.session.policy import ReconnectPolicy, RetryPolicy
from hexwire.wire import servo_packet as sp
from hexwire.wire.command_frame import Command
from hexwire.wire.commands import LimitRow, OffsetRow

DIALECTS = pytest.mark.parametrize("dialect", [1, 2])


def replug(arm: Arm, seconds: float = 1.0) -> None:
    """Unplug now; it is back after a while."""
    arm.link.lost = True
    back = arm.clock.time + seconds
    plain = arm.link.open

    def open_when_back() -> None:
        arm.link.lost = arm.clock.time < back
        plain()

    arm.link.open = open_when_back  # type: ignore[method-assign]  # the plug comes back at its time


# --- coming and going ------------------------------------------------------------------------------------------


def test_constructing_does_no_io_and_using_it_unattached_says_so() -> None:
    driver = Hex7BotDriver.from_url("/dev/not-there")
    for call in (driver.read, driver.probe, driver.stop, driver.resume, lambda: driver.dialect):
        with pytest.raises(UsageError, match="not attached; call attach"):
            call()
    driver.detach()


@DIALECTS
@pytest.mark.parametrize("baud", [0, 115200])
def test_attaching_moves_nothing_and_switches_nothing(dialect: int, baud: int) -> None:
    arm = Arm(dialect, baud)
    arm.driver.read()
    arm.driver.probe()
    arm.wait(1)
    assert arm.torques() == [False] * 7
    assert arm.shafts() == [2053, 2043, 2035, 2039, 2083, 2046, 2047]
    assert set(arm.commands()) <= {Command.IDENTIFY, Command.JOINT_STATE, Command.STATS, Command.PING, Command.READ}


@DIALECTS
def test_as_a_context_manager_and_detaching(dialect: int) -> None:
    arm = Arm(dialect, attach=False)
    with arm.driver as driver:
        assert driver.dialect == dialect
        driver.torque(True)
    assert not arm.link.is_open
    assert arm.torques() == [True] * 7  # detaching holds what is held
    arm.driver.attach()
    arm.driver.detach(torque_off=True)
    assert arm.torques() == [False] * 7
    arm.driver.detach()


def test_a_board_deaf_while_it_boots_is_waited_for() -> None:
    arm = Arm(2, 115200, ("boot:3",))
    assert arm.driver.dialect == 2
    assert 3 <= arm.clock.time - 1000 < 4


def test_a_board_that_never_answers_leaves_nothing_open() -> None:
    arm = Arm(2, 0, ("boot:999",), attach=False)
    with pytest.raises(ReplyTimeoutError, match="IDENTIFY"):
        arm.driver.attach()
    assert not arm.link.is_open


def test_one_dialect_only_if_so_asked() -> None:
    arm = Arm(2, attach=False)
    driver = Hex7BotDriver(arm.driver.session, dialect=1)
    driver.attach()
    assert driver.dialect == 1
    assert driver.read().silent == ()


# --- states ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("baud", [0, 115200])
def test_a_dialect_2_state_in_si_units(baud: int) -> None:
    arm = Arm(2, baud)
    arm.wait(0.2)
    state = arm.driver.read()
    printed = {"J1": -4.47257, "J2": 54.6484, "J3": -3.55452, "J4": -0.703134, "J5": 3.1641, "J6": -0.0878917}
    for name, degrees in printed.items():
        assert float(f"{math.degrees(state[name].position):.6g}") == degrees
    assert all(map(math.isnan, state.load[:4] + state.current[:4] + state.voltage[:4] + state.temperature[:4]))
    assert state.load[4:] == pytest.approx((0, 0, 0.052))
    assert state.voltage[4:] == pytest.approx((6.0,) * 3)
    assert state.temperature[4:] == pytest.approx((28,) * 3)
    assert state.velocity == pytest.approx((0,) * 7)
    assert state.flags == (0,) * 7
    assert not state.stopped


def test_velocity_current_and_load_have_the_joints_sign() -> None:
    arm = Arm(2, 115200)
    arm.driver.torque(True)
    arm.driver.write(JointTarget.of({"J1": -1.0, "J5": -1.0}, 1.0))
    arm.wait(0.5)
    state = arm.driver.read()
    assert state["J1"].velocity == pytest.approx(-0.92, rel=0.2)
    assert state["J5"].velocity == pytest.approx(-1.05, rel=0.15)
    assert state["J5"].load < 0


def test_the_boards_clock_is_placed_on_the_hosts_and_wraps() -> None:
    for uptime in (0.5, 4294.0, 4294.95, 4295.1, 5000.0, 8589.95):
        arm = Arm(2, 0 if uptime > 1 else 115200)
        arm.clock.advance(uptime)
        state = arm.driver.read()
        assert 0 <= arm.clock.time - state.stamp < 0.04
        assert state.board_time == pytest.approx(state.stamp - 1000.0, abs=0.02)


def test_stop_resume_and_the_state_says_stopped() -> None:
    arm = Arm(2)
    arm.driver.torque(True)
    assert arm.driver.stop() == HEX7BOT.names
    assert arm.driver.read().stopped
    assert arm.driver.probe().stopped
    with pytest.raises(StoppedError, match="resume"):
        arm.driver.write(JointTarget.of({"J1": 0.0}))
    arm.driver.resume()
    assert not arm.driver.read().stopped


# --- moves -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("baud", [0, 115200])
def test_the_sent_target_is_returned_and_is_in_the_servos(baud: int) -> None:
    arm = Arm(2, baud)
    arm.driver.torque(True)
    angles = {"J1": 0.2, "j2": 1.3, "J3": 0.5, "J4": -0.5, "J5": 0.3, "J6": 1.0, "J7": -0.2}
    sent = arm.driver.write(JointTarget.of(angles, 1.0))
    assert [name for name, _ in sent.positions] == list(HEX7BOT.names)
    arm.wait(1.3)
    for (name, angle), wanted in zip(sent.positions, angles.values(), strict=True):
        joint = HEX7BOT.joint(name)
        assert abs(angle - wanted) <= joint.scale / 2
        row = "target_position" if joint.series == "seven_bot" else "goal_position"
        assert arm.board.wire[joint.servo_id].registers.get(row) == joint.angle_to_counts(angle)
    assert arm.driver.read().position == pytest.approx([a for _, a in sent.positions], abs=0.0031)


def test_limits_are_refused_before_anything_is_sent_and_speeds_lengthen() -> None:
    arm = Arm(2)
    arm.driver.torque(True)
    arm.driver.read()
    arm.link.written.clear()
    with pytest.raises(LimitError, match=r"J1=171\.9 deg is outside its limits -85 to 75 deg; nothing was sent"):
        arm.driver.write(JointTarget.of({"J5": 0.0, "J1": 3.0}))
    with pytest.raises(UsageError, match="no joint 'J9'"):
        arm.driver.write(JointTarget.of({"J9": 0.0}))
    with pytest.raises(UsageError, match="twice"):
        arm.driver.write(JointTarget.of({"J1": 0.0, "j1": 0.1}))
    assert arm.link.written == []
    sent = arm.driver.write(JointTarget.of({"J1": 1.2}, 0.1))
    assert sent.duration == pytest.approx((1.2 + 0.078) / 2.6, abs=0.01)
    # And the next is judged from where this one ends.
    back = arm.driver.write(JointTarget.of({"J1": 0.0}, 0.1))
    assert back.duration == pytest.approx(1.2 / 2.6, abs=0.01)


def test_a_move_without_torque_is_refused() -> None:
    with pytest.raises(CommandRefusedError, match="torque on"):
        Arm(2).driver.write(JointTarget.of({"J1": 0.0}))


def test_clamped_and_silent_joints_are_named() -> None:
    arm = Arm(2)
    rows = list(arm.driver.limits())
    rows[0] = LimitRow(2000, 2100, 4096)
    assert arm.driver.store_limits(rows) == tuple(rows)
    arm.driver.torque(True)
    arm.board.wire.servos[6].registers.put("id", 60)
    sent = arm.driver.write(JointTarget.of({"J1": 0.5, "J4": 0.1, "J7": 0.1}))
    assert sent.clamped == ("J1",)
    assert sent.silent == ("J7",)
    assert dict(sent.positions)["J1"] == HEX7BOT.joint("J1").counts_to_angle(2100)


# --- settings and tools ----------------------------------------------------------------------------------------


def test_limits_and_offsets() -> None:
    driver = Arm(2).driver
    stored = driver.store_limits()
    assert [(r.minimum, r.maximum) for r in stored] == [j.count_limits for j in HEX7BOT.joints]
    assert driver.limits() == stored
    offsets = (OffsetRow(2040, -1),) * 7
    assert driver.store_offsets(offsets) == driver.offsets() == offsets
    with pytest.raises(UsageError, match="does not fit"):
        driver.store_limits([LimitRow(-40000, 0, 1)] * 7)
    with pytest.raises(UsageError, match="does not fit"):
        driver.store_offsets([OffsetRow(0, 1000)] * 7)
    with pytest.raises(CommandRefusedError, match="bad range"):
        driver.store_limits([LimitRow(5, 4, 1)] * 7)


def test_watchdog_and_stream_refuse_invalid_values() -> None:
    driver = Arm(2).driver
    for seconds in (0.01, 61.0, -1.0, math.nan):
        with pytest.raises(UsageError, match=r"outside|takes a number"):
            driver.watchdog(seconds)
    for seconds in (0.0, 0.001, 70.0, math.nan):
        with pytest.raises(UsageError, match=r"outside|takes a number"):
            next(driver.stream(seconds))


def test_transact_ioctl_ping_stats_and_signals() -> None:
    arm = Arm(2, 0, ("silent:3",))
    driver = arm.driver
    assert driver.transact(sp.make_read(0, 56, 2), 8) == bytes.fromhex("FF F5 00 04 00 08 05 EE")
    assert driver.transact(sp.make_sync_write(0x28, {0: b"\0"}), 0) == b""
    with pytest.raises(UsageError, match="at most"):
        driver.transact(sp.make_ping(0), 300)
    with pytest.raises(UsageError, match="at most"):
        driver.transact(sp.make_ping(0), 6, 1.0)
    assert driver.ioctl(Command.IO, b"\7\5") == b"\7\5"
    still = (Command.IO, b"\7\5"), (Command.STATS, b""), (Command.STOP, b"\0"), (Command.TORQUE, b"\0\0")
    assert not any(driver.may_move(*command) for command in still)
    assert all(
        driver.may_move(*command) for command in ((Command.JOINT_MOVE, b""), (Command.OFFSETS, b"\1"), (0x66, b""))
    )
    with pytest.raises(CommandRefusedError):
        driver.ioctl(0x66)
    assert driver.ping(0) == 0
    assert driver.ping(3) is None
    assert driver.board_counters()["frames_received"] > 5
    driver.signal(Signal.TORQUE_ON)
    assert sum(arm.torques()) == 6
    driver.signal(Signal.STOP_TORQUE_OFF)
    assert not any(arm.torques())
    with pytest.raises(StoppedError):
        driver.signal(Signal.TORQUE_ON)
    driver.signal(Signal.RESUME)
    driver.signal(Signal.STOP)
    assert driver.read().stopped
    with pytest.raises(UsageError, match=r"no signal 9; there are 1 STOP"):
        driver.signal(9)


def test_probe() -> None:
    report = Arm(2, 115200, ("silent:5",)).driver.probe()
    assert (report.robot, report.dialect, report.firmware) == ("hex7bot", 2, "2.1.0")
    assert report.missing == ("J6",)
    assert "joint_move" in report.capabilities
    assert report.counters["board_bus_timeouts"] > 0
    assert report.counters["retries"] == 0


def test_stop_modes() -> None:
    for mode, on in ((StopMode.HOLD, True), (StopMode.TORQUE_OFF, False)):
        arm = Arm(2, 115200)
        arm.driver.torque(True)
        arm.driver.write(JointTarget.of({"J1": 1.0}, 3.0))
        arm.wait(1.0)
        assert arm.driver.stop(mode) == HEX7BOT.names
        at = arm.shaft(0)
        arm.wait(3)
        assert arm.torques() == [on] * 7
        assert arm.shaft(0) == pytest.approx(at, abs=40)


# --- reports ---------------------------------------------------------------------------------------------------


def test_a_stream_gives_states_at_its_rate_and_ends_the_reports() -> None:
    arm = Arm(2, 115200)
    first = arm.driver.stream(0.05)
    states = list(itertools.islice(first, 20))
    stamps = [s.stamp for s in states]
    assert stamps[-1] - stamps[0] == pytest.approx(19 * 0.05, abs=0.05)
    assert arm.board.state.report_due is not None
    first.close()
    assert arm.board.state.report_due is None
    stream = arm.driver.stream(0.05)
    next(stream)
    arm.driver.probe()  # an IDENTIFY would end the reports
    arm.driver.read()
    assert len(list(itertools.islice(stream, 5))) == 5
    stream.close()
    assert arm.board.state.report_due is None


def test_short_reports_come_more_often_on_a_slow_line_and_lack_nothing_but_velocities() -> None:
    def run(slow: float | None) -> tuple[list[JointState], int]:
        arm = Arm(2, 115200)
        before = arm.commands().count(Command.JOINT_STATE)
        stream = arm.driver.stream(0.005, slow=slow)
        states = list(itertools.islice(stream, 300))
        stream.close()
        return states, arm.commands().count(Command.JOINT_STATE) - before

    (whole, none), (short, asked) = run(None), run(2.0)
    rates = [299 / (states[-1].stamp - states[0].stamp) for states in (whole, short)]
    assert rates[1] > 1.1 * rates[0]
    assert (none, asked) == (0, 2), "at the start, and two seconds later"
    assert 2.0 < short[-1].stamp - short[0].stamp < 4.0
    for column in ("load", "current", "voltage", "temperature", "age", "position"):
        known = [[math.isfinite(value) for value in getattr(states[-1], column)] for states in (whole, short)]
        assert known[0] == known[1]
    assert all(math.isfinite(value) for value in whole[-1].velocity)
    assert all(math.isnan(value) for state in short for value in state.velocity)


def test_a_program_that_only_reads_reports_feeds_the_watchdog() -> None:
    arm = Arm(2)
    arm.driver.watchdog(0.3)
    stream = arm.driver.stream(0.05)
    begin = arm.clock.time
    tripped = [state.watchdog_tripped for state in itertools.islice(stream, 100)]
    assert arm.clock.time - begin > 4.0
    assert not any(tripped)
    stream.close()
    arm.wait(1.0)
    assert arm.driver.read().watchdog_tripped, "nobody feeds it any more"


def test_listening_does_not_hide_that_the_watchdog_tripped() -> None:
    arm = Arm(2)
    arm.driver.watchdog(0.3)
    arm.wait(1.0)
    states = list(itertools.islice(arm.driver.stream(0.05), 100))
    assert all(state.watchdog_tripped for state in states)
    assert states[-1].stamp - states[0].stamp > 4.0
    assert arm.board.state.watchdog_trips == 1, "it was fed, and did not trip again"


def older(arm: Arm) -> None:
    """As firmware 2.0 has it: the command WATCHDOG makes the board forget that the watchdog has tripped."""
    assert isinstance(arm.driver._board, Board2)
    arm.driver._board.identity = arm.driver._board.identity._replace(capabilities=0)
    receive = arm.board.dialect2._watchdog

    def forgets(request: object) -> object:
        arm.board.state.watchdog_tripped = False
        return receive(request)  # type: ignore[arg-type]  # as it came

    arm.board.dialect2._handlers[Command.WATCHDOG] = forgets  # type: ignore[assignment]  # another firmware


def test_the_cause_of_a_stop_is_kept_when_an_older_board_forgets_it() -> None:
    arm = Arm(2)
    older(arm)
    arm.driver.watchdog(0.3)
    arm.wait(1.0)
    arm.driver.watchdog(0.5)  # armed once more before anybody has looked
    assert arm.driver.read().watchdog_tripped
    assert all(state.watchdog_tripped for state in itertools.islice(arm.driver.stream(0.05), 50))
    arm.driver.watchdog(0.0)
    assert arm.board.state.stopped
    assert arm.driver.read().watchdog_tripped
    arm.driver.resume()
    assert not arm.driver.read().watchdog_tripped


def test_the_watchdog_of_a_program_is_armed_while_it_moves_and_no_longer() -> None:
    arm = Arm(2)
    with arm.driver.watched(0.4) as covered:
        assert covered
        assert arm.board.state.watchdog_timeout == pytest.approx(0.4)
        with arm.driver.watched(2.0) as inner:
            assert inner
            assert arm.board.state.watchdog_timeout == pytest.approx(0.4), "who armed it keeps it"
        assert arm.board.state.watchdog_timeout == pytest.approx(0.4)
    assert arm.board.state.watchdog_timeout == 0
    with Arm(1).driver.watched() as covered:
        assert not covered


def test_a_report_that_waited_keeps_the_time_of_its_arrival() -> None:
    arm = Arm(2)
    stream = arm.driver.stream(0.05)
    first = next(stream).stamp
    arm.driver.session.negotiate()  # something that takes its time, while a report comes
    arm.driver._board.report(0.05)  # type: ignore[union-attr]  # an IDENTIFY ends the reports
    begin = arm.clock.time
    while not arm.driver.session._reports:
        arm.driver.board_counters()
        arm.wait(0.01)
    arrived = arm.clock.time
    arm.wait(0.3)
    assert first < begin <= next(stream).stamp <= arrived


@pytest.mark.parametrize(("dialect", "rate"), [(1, 1.5), (2, 20.0)])
def test_command_rate_is_what_the_line_takes(dialect: int, rate: float) -> None:
    arm = Arm(dialect)
    assert arm.driver.command_rate == rate
    assert arm.driver.sessions == (arm.driver.session,)


def test_a_stream_survives_a_reset_and_a_replug() -> None:
    arm = Arm(2)
    arm.driver.watchdog(30.0)
    stream = arm.driver.stream(0.05)
    next(stream)
    arm.wait(5)
    arm.board.reset(arm.clock.time)
    states = list(itertools.islice(stream, 400))
    assert len(states) == 400
    assert arm.board.state.watchdog_timeout == 30.0
    replug(arm)
    assert len(list(itertools.islice(stream, 400))) == 400
    assert arm.driver.session.generation == 1
    stream.close()


# --- losing the port and the board -----------------------------------------------------------------------------


@DIALECTS
def test_reads_continue_after_a_replug_and_a_move_is_not_repeated(dialect: int) -> None:
    arm = Arm(dialect)
    arm.driver.torque(True)
    before = arm.driver.read()
    replug(arm)
    assert arm.driver.read().position == before.position
    assert arm.driver.host_counters()["reconnects"] == 1
    arm.driver.torque(True)
    arm.driver.read()
    shaft = arm.shaft(0)
    replug(arm)
    with pytest.raises(LinkLostError, match=r"is open again; .* was not repeated"):
        arm.driver.write(JointTarget.of({"J1": 0.5}))
    arm.wait(1.5)
    assert arm.shaft(0) == shaft
    arm.driver.write(JointTarget.of({"J1": 0.5}))
    arm.wait(1.5)
    assert arm.shaft(0) != shaft


@pytest.mark.parametrize("reset", [False, True])
def test_watchdog_and_reports_are_armed_again_after_a_replug(reset: bool) -> None:
    arm = Arm(2)
    arm.driver.watchdog(0.5, StopMode.TORQUE_OFF)
    replug(arm)
    if reset:
        arm.board.reset(arm.clock.time)
    arm.driver.read()
    assert arm.board.state.watchdog_timeout == 0.5
    assert arm.board.state.watchdog_mode == 1


@pytest.mark.parametrize("uptime", [0.5, 30.0])
@pytest.mark.parametrize("by", ["read", "write", "torque"])
def test_a_reset_without_losing_the_port_is_noticed_and_the_watchdog_armed_again(by: str, uptime: float) -> None:
    arm = Arm(2)
    arm.driver.torque(True)
    arm.driver.read()
    arm.wait(uptime)
    arm.driver.watchdog(20.0)
    arm.board.reset(arm.clock.time)
    arm.wait(uptime + 3)
    arm.driver.read() if by == "read" else None
    arm.driver.write(JointTarget.of({"J1": 0.1})) if by == "write" else None
    arm.driver.torque(True) if by == "torque" else None
    assert arm.board.state.watchdog_timeout == 20.0


def test_arming_again_is_tried_until_it_works() -> None:
    arm = Arm(2)
    arm.driver.watchdog(20.0)
    arm.driver.read()
    arm.wait(5)
    arm.board.reset(arm.clock.time)
    write = arm.link.write

    def no_watchdog(data: bytes, deadline: float | None = None) -> None:
        if data[38] != Command.WATCHDOG:
            write(data, deadline)

    arm.link.write = no_watchdog  # type: ignore[method-assign]  # those frames get lost
    for _ in range(3):
        with pytest.raises(ReplyTimeoutError, match="WATCHDOG"):
            arm.driver.read()
    assert arm.driver.stop() == HEX7BOT.names  # nothing goes before a stop
    arm.link.write = write  # type: ignore[method-assign]  # and back
    arm.driver.read()
    assert arm.board.state.watchdog_timeout == 20.0


def test_a_board_of_the_other_dialect_after_a_replug() -> None:
    arm = Arm(2)
    arm.driver.watchdog(20.0)
    replug(arm)
    arm.link.device = make_hex7bot_board(dialect=1, start=arm.clock.time)
    with pytest.raises((NotSupportedError, LinkLostError)):
        arm.driver.torque(False)
    with pytest.raises(NotSupportedError, match="no watchdog"):
        arm.driver.read()
    assert arm.driver.dialect == 1
    assert arm.driver.read().silent == ()


def test_a_stop_of_dialect_1_outlives_a_replug() -> None:
    arm = Arm(1)
    arm.driver.torque(True)
    arm.driver.stop()
    replug(arm)
    assert arm.driver.read().stopped
    assert isinstance(arm.driver._board, Board1)
    with pytest.raises(StoppedError):
        arm.driver.write(JointTarget.of({"J1": 0.0}))
    assert arm.driver.read().stopped


@pytest.mark.parametrize("when", ["begin", "end"])
def test_a_line_that_is_lost_while_reports_begin_or_end_comes_back(when: str) -> None:
    arm = Arm(2)
    states = arm.driver.stream(0.05)
    if when == "end":
        next(states)
    replug(arm)
    if when == "begin":
        assert next(states).names == HEX7BOT.names
    states.close()
    assert arm.board.state.report_due is None
    assert arm.driver.read().names == HEX7BOT.names


def test_giving_up_is_final() -> None:
    arm = Arm(2, reconnect=ReconnectPolicy(give_up_after=3))
    arm.link.lost = True
    with pytest.raises(LinkLostError, match="did not come back within 3 s"):
        arm.driver.read()


# --- a stop from another thread --------------------------------------------------------------------------------


@pytest.mark.parametrize("dialect", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_a_stop_from_another_thread_interrupts_a_request_to_a_silent_board(dialect: int) -> None:
    near, far = memory_pair()
    far.open()
    ended, deaf = threading.Event(), threading.Event()
    board = make_hex7bot_board(dialect=dialect, start=time.monotonic())

    def serve() -> None:
        while not ended.is_set():
            data = far.read(time.monotonic() + 0.005)
            now = time.monotonic()
            if data and (not deaf.is_set() or (dialect == 2 and data[38] == Command.STOP)):
                board.receive(data, now)
            board.step(now)
            out = board.data_to_send()
            if out:
                far.write(out)

    server = threading.Thread(target=serve)
    server.start()
    policy = RetryPolicy(window=30.0, dialect1_window=2.0)
    driver = Hex7BotDriver(Session(IpcHandle.from_link(near), policy=policy))
    outcome: list[Exception] = []

    def reading() -> None:
        try:
            while True:
                driver.read()
        except PreemptedError as error:
            outcome.append(error)

    try:
        driver.attach()
        driver.torque(True)
        deaf.set()
        reader = threading.Thread(target=reading)
        reader.start()
        while driver.session._turn.owner == 0:
            time.sleep(0.005)
        time.sleep(0.2)
        if dialect == 1:
            deaf.clear()
        stopped = driver.stop()
        reader.join(30)
        assert not reader.is_alive()
        assert stopped == HEX7BOT.names
        assert outcome
    finally:
        ended.set()
        server.join(30)
        driver.detach()
        far.close()


# --- hostile lines ---------------------------------------------------------------------------------------------

NOISE = ("flip:0.02", "drop:0.02", "dup:0.02", "junk:0.02", "cut:0.02")
BUS = tuple(f"bus.{fault}" for fault in NOISE)


@pytest.mark.parametrize("reads", [250, pytest.param(2500, marks=pytest.mark.slow)])
def test_reads_over_hostile_lines_give_no_wrong_value_and_count_every_loss(reads: int) -> None:
    arm = Arm(2, 0, (*NOISE, *BUS), seed=11, policy=RetryPolicy(attempts=12))
    arm.driver.torque(True)
    arm.driver.read()
    wrong = 0
    for i in range(reads):
        if i % 250 == 0:
            arm.driver.write(JointTarget.of({"J1": 0.3 if i % 500 else -0.3, "J5": 0.3 if i % 500 else -0.3}, 2.0))
        state = arm.driver.read()
        for reading, joint in zip(state, HEX7BOT.joints, strict=True):
            true = joint.counts_to_angle(arm.shaft(joint.servo_id))
            # 0.3 rad/s; a sample is as old as the state's stamp and its age say, a repeated answer's too.
            old = arm.clock.time - state.stamp + reading.age
            if abs(reading.position - true) > 0.005 + 0.35 * (old + 0.002):
                wrong += 1
        arm.wait(0.01)
    assert wrong == 0
    host = arm.driver.host_counters()
    assert host["retries"] > reads / 50
    assert host["timeouts"] == 0
    stats = arm.driver.board_counters()
    assert stats["bus_bad"] + stats["bus_timeouts"] > reads / 25
    assert stats["bad_frames"] + stats["resyncs"] > reads / 50
    assert stats["repeats"] > reads / 125
    assert arm.board.faults.__class__ is FaultPlan


def test_a_stream_leaves_out_the_reports_of_other_boards() -> None:
    channel, link, session = open_channel(8, 9)
    channel.boards[9].wire[0].motion.position += 300
    arm = Hex7BotDriver(session)
    session.close()
    arm.attach()
    here = arm.read().positions["J1"]
    states = arm.stream(0.05)
    next(states)
    answers = session.request_all(Command.REPORT, b"\x32\0\0", [8, 9])
    assert not answers.silent
    link.clock.advance(0.2)
    assert {round(next(states).positions["J1"] - here, 3) for _ in range(6)} == {0.0}


NOISES = [("flip:0.1",), ("drop:0.1", "dup:0.05"), ("cut:0.08",), ("junk:0.3", "host.flip:0.05")]


@pytest.mark.parametrize("noise", NOISES, ids=str)
def test_long_requests_and_answers_survive_a_bad_line(noise: tuple[str, ...]) -> None:
    arm = Arm(2, faults=noise, policy=RetryPolicy(attempts=12), seed=3)
    arm.driver.maintenance(True)
    for number in range(6):
        table = arm.driver.read_table("J6")
        assert table[:40] == arm.board.wire[5].registers.read(0, 40)
        settings = bytearray(table[6:40])
        settings[21 - 6] = 30 + number
        arm.driver.write_table("J6", 6, bytes(settings))
        assert arm.board.wire[5].registers.read(21, 1) == bytes((30 + number,))
    arm.driver.maintenance(False)
    for _ in range(4):
        path = arm.driver.path(["J1", "J5"], smooth=False)
        here = arm.driver.read().positions
        points = [TimedPoint(0.02 * n, (here["J1"] + 0.001 * n, here["J5"])) for n in range(120)]
        assert path.send(points, last=True) == 120
        made = arm.board.trajectory.path
        assert made is not None
        assert made.next == 120
    assert arm.driver.session.connection.counters.retries, "some of it was lost"

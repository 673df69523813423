from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hexwire.emulator.servo import REBOOT_TIME, EmulatedServo
from hexwire.errors import UsageError
from hexwire.wire import servo_packet as sp
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import BROADCAST_ID, Instruction, ServoPacket, StatusPacket


class Bench:
    """A servo on a bench: packets by register name, and a clock."""

    def __init__(self, series: Series, servo_id: int = 1, **options: object) -> None:
        self.servo = EmulatedServo(series, servo_id, **options)  # type: ignore[arg-type]
        self.series = series
        self.now = 0.0

    def send(self, data: bytes) -> StatusPacket | None:
        answer = self.servo.receive(sp.parse_packet(data), self.now)
        return None if answer is None else sp.parse_status(answer)

    def write(self, **values: int) -> StatusPacket | None:
        status = None
        for name, value in values.items():
            row = self.series.register(name)
            status = self.send(sp.make_write(self.servo.servo_id, row.address, row.encode(value)))
        return status

    def read(self, name: str) -> int:
        row = self.series.register(name)
        status = self.send(sp.make_read(self.servo.servo_id, row.address, row.size))
        assert status is not None
        return row.decode(status.params)

    def wait(self, seconds: float) -> None:
        self.now += seconds
        self.servo.step(self.now)


def block(acceleration: int, position: int, torque: int, speed: int) -> bytes:
    words = (Series.HLS.register("goal_position").encode(position), torque.to_bytes(2, "little"))
    return bytes((acceleration,)) + b"".join(words) + speed.to_bytes(2, "little")


# --- reading -----------------------------------------------------------------------------------------------


def test_the_chapters_reads_are_answered_as_in_its_log() -> None:
    gripper = EmulatedServo(Series.HLS, 6, position=2047, idle_load=52)
    base = EmulatedServo(Series.SEVEN_BOT, 0, position=2053)
    load = sp.parse_packet(bytes.fromhex("FF FF 06 04 02 3C 02 B5"))
    position = sp.parse_packet(bytes.fromhex("FF FF 00 04 02 38 02 BF"))
    assert gripper.receive(load, 0.0) == bytes.fromhex("FF FF 06 04 00 34 00 C1")
    assert base.receive(position, 0.0) == bytes.fromhex("FF F5 00 04 00 08 05 EE")


def test_pings() -> None:
    ping = ServoPacket(1, Instruction.PING, b"")
    assert EmulatedServo(Series.SEVEN_BOT, 1).receive(ping, 0.0) == bytes.fromhex("FF F5 01 06 00 F8")
    assert EmulatedServo(Series.HLS, 1).receive(ping, 0.0) == bytes.fromhex("FF FF 01 02 00 FC")
    assert EmulatedServo(Series.HLS, 2).receive(ping, 0.0) is None
    everyone = ServoPacket(BROADCAST_ID, Instruction.PING, b"")
    assert EmulatedServo(Series.HLS, 2).receive(everyone, 0.0) == sp.make_status(2)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 15])
def test_legacy_servos_fail_long_reads(count: int) -> None:
    status = Bench(Series.SEVEN_BOT).send(sp.make_read(1, 56, count))
    assert (status is not None) == (count <= 2)


def test_feetech_servos_answer_long_reads_up_to_the_end_of_memory() -> None:
    bench = Bench(Series.HLS, position=1000)
    status = bench.send(sp.make_read(1, 56, 15))
    assert status is not None
    assert status.params[:2] == (1000).to_bytes(2, "little")
    assert bench.send(sp.make_read(1, 250, 7)) is None
    assert bench.servo.receive(ServoPacket(1, Instruction.READ, b"\x38"), 0.0) is None
    assert bench.servo.receive(ServoPacket(1, Instruction.READ, b"\x38\x00"), 0.0) is None


def test_legacy_speed_voltage_temperature_and_current_read_zero() -> None:
    bench = Bench(Series.SEVEN_BOT, position=1000)
    bench.write(target_position=3000)
    bench.wait(0.2)
    assert bench.read("present_position") > 1050
    for name in ("present_speed", "present_voltage", "present_temperature", "present_current"):
        assert bench.read(name) == 0


def test_present_values_of_a_moving_servo() -> None:
    bench = Bench(Series.HLS, position=1000)
    bench.write(goal_position=3000)
    bench.wait(0.3)
    assert bench.read("present_speed") == 60
    assert bench.read("present_load") > 300
    assert bench.read("moving") == 3
    assert bench.read("present_voltage") == 60
    assert bench.read("present_temperature") == 28
    assert bench.read("target_position") == 3000
    bench.wait(1.0)
    assert bench.read("present_position") == 3000
    assert bench.read("moving") == bench.read("present_speed") == bench.read("present_load") == 0
    bench.write(goal_position=1000)
    bench.wait(0.3)
    assert bench.read("present_speed") == -60
    assert bench.read("present_load") < -300
    assert bench.read("present_current") < 0


def test_noise_moves_the_reading_and_not_the_shaft() -> None:
    quiet, noisy = Bench(Series.HLS, position=2000), Bench(Series.HLS, position=2000, noise=2.0, seed=5)
    readings = []
    for _ in range(20):
        noisy.wait(0.01)
        readings.append(noisy.read("present_position"))
        assert readings[-1] == noisy.read("present_position")
    assert len(set(readings)) > 3
    assert quiet.read("present_position") == noisy.servo.present_position == 2000


# --- moving ------------------------------------------------------------------------------------------------


def test_legacy_move_takes_its_run_time() -> None:
    bench = Bench(Series.SEVEN_BOT, position=1000)
    data = (2047).to_bytes(2, "big") + (1720).to_bytes(2, "big")
    assert bench.send(sp.make_sync_write(42, {1: data})) is None
    bench.wait(0.86)
    assert bench.read("present_position") == pytest.approx(1523, abs=5)
    bench.wait(0.84)
    assert 2030 < bench.read("present_position") < 2047
    bench.wait(0.1)
    assert bench.read("present_position") == 2047


def test_legacy_run_time_zero_is_as_fast_as_possible() -> None:
    bench = Bench(Series.SEVEN_BOT, position=1000)
    bench.send(sp.make_write(1, 42, (2000).to_bytes(2, "big") + b"\0\0"))
    bench.wait(0.4)
    assert bench.read("present_position") == 2000


def test_legacy_writes_are_not_answered_unless_asked_for() -> None:
    assert Bench(Series.SEVEN_BOT).write(torque_enable=1) is None
    status = Bench(Series.SEVEN_BOT, answers_writes=True).write(torque_enable=1)
    assert status == StatusPacket(1, 0, b"", True)


def test_hls_block_move() -> None:
    bench = Bench(Series.HLS, position=2000)
    bench.send(sp.make_write(1, 41, block(50, 2600, 300, 20)))
    bench.wait(0.4)
    assert bench.read("present_speed") == 20
    bench.wait(1.0)
    assert bench.read("present_position") == 2600


def test_the_chapters_sync_write_paralyses_an_hls_servo() -> None:
    bench = Bench(Series.HLS, position=2000)
    bench.send(sp.make_sync_write(42, {1: (2600).to_bytes(2, "little") + (0).to_bytes(2, "little")}))
    bench.wait(1.0)
    assert bench.read("goal_torque") == 0
    assert bench.read("present_position") == 2000
    bench.send(sp.make_sync_write(42, {1: (2600).to_bytes(2, "little") + (1720).to_bytes(2, "little")}))
    bench.wait(1.0)
    assert bench.read("present_position") == 2600


def test_position_limits_clamp_the_goal() -> None:
    bench = Bench(Series.HLS, position=2000, settings={"min_position_limit": 1900, "max_position_limit": 2100})
    for goal, arrives in ((4000, 2100), (0, 1900)):
        bench.write(goal_position=goal)
        bench.wait(2.0)
        assert bench.read("present_position") == arrives


def test_writing_a_goal_turns_the_torque_on() -> None:
    for series in (Series.STS_SMS, Series.HLS):
        bench = Bench(series, position=2000)
        assert bench.read("torque_enable") == 0
        bench.write(goal_position=2100)
        assert bench.read("torque_enable") == 1


def test_torque_on_holds_and_off_lets_go() -> None:
    bench = Bench(Series.HLS, position=2000, gravity=lambda shaft: -0.3)
    bench.write(torque_enable=1)
    bench.wait(1.0)
    assert bench.read("present_position") == bench.read("goal_position") == 2000
    assert bench.read("present_load") == 300
    bench.write(torque_enable=0)
    bench.wait(0.3)
    assert bench.read("present_position") < 1900
    assert bench.read("present_load") == 0


def test_torque_on_forgets_an_old_goal() -> None:
    bench = Bench(Series.HLS, position=2000)
    bench.write(goal_position=3000)
    bench.wait(0.1)
    bench.write(torque_enable=0)
    bench.wait(0.5)
    stands = bench.read("present_position")
    bench.write(torque_enable=1)
    bench.wait(0.5)
    assert bench.read("present_position") == stands < 2500


def test_speed_mode_turns_past_the_end_of_the_scale() -> None:
    bench = Bench(Series.HLS, position=4000, settings={"mode": 1})
    bench.write(torque_enable=1, goal_speed=20)
    bench.wait(0.5)
    assert 300 < bench.read("present_position") < 500
    assert bench.read("present_speed") == 20
    bench.write(goal_speed=0)
    bench.wait(0.5)
    assert bench.read("present_speed") == 0


def test_multi_turn_counts_on_and_reset_state_forgets_the_turns() -> None:
    bench = Bench(Series.HLS, position=4000, settings={"min_position_limit": 0, "max_position_limit": 0})
    bench.write(goal_position=9000)
    bench.wait(3.0)
    assert bench.read("present_position") == 9000
    assert bench.send(sp.make_reset_state(1)) == StatusPacket(1, 0, b"", False)
    assert bench.read("present_position") == 9000 - 8192
    bench.wait(1.0)
    assert bench.read("present_position") == 9000 - 8192


def test_sts_step_mode_adds() -> None:
    bench = Bench(Series.STS_SMS, position=2000, settings={"mode": 3})
    for arrives in (2300, 2600):
        bench.write(goal_position=300)
        bench.wait(2.0)
        assert bench.read("present_position") == arrives


def test_scs_wheel_mode_is_pwm_in_the_time_register() -> None:
    bench = Bench(Series.SCS, position=200, settings={"max_position_limit": 0})
    bench.write(goal_time=500)
    bench.wait(0.3)
    assert bench.read("present_speed") == pytest.approx(1025, abs=2)


# --- settings ----------------------------------------------------------------------------------------------


def test_locked_settings_are_lost_at_the_next_start() -> None:
    bench = Bench(Series.HLS)
    bench.write(max_position_limit=3000)
    assert bench.read("max_position_limit") == 3000
    bench.send(sp.make_reboot(1))
    bench.wait(REBOOT_TIME)
    assert bench.read("max_position_limit") == 4095
    bench.write(lock=0, max_position_limit=3000, id=9, torque_enable=1)
    bench.send(sp.make_reboot(9))
    bench.wait(REBOOT_TIME)
    assert bench.servo.servo_id == 9
    assert bench.read("max_position_limit") == 3000
    assert bench.read("lock") == 1
    assert bench.read("torque_enable") == 0


def test_reboot_is_silent_for_its_time() -> None:
    bench = Bench(Series.STS_SMS)
    assert bench.send(sp.make_reboot(1)) is None
    bench.wait(REBOOT_TIME - 0.002)
    assert bench.send(sp.make_ping(1)) is None
    bench.wait(0.002)
    assert bench.send(sp.make_ping(1)) is not None


def test_an_id_change_is_answered_by_the_old_id() -> None:
    bench = Bench(Series.HLS, 1)
    status = bench.write(id=2)
    assert status is not None
    assert status.servo_id == 1
    assert bench.send(sp.make_ping(1)) is None
    assert bench.send(sp.make_ping(2)) is not None


def test_status_return_level_zero_answers_reads_only() -> None:
    bench = Bench(Series.HLS)
    bench.write(status_return_level=0)
    assert bench.write(torque_enable=1) is None
    assert bench.send(sp.make_action(1)) is None
    assert bench.read("torque_enable") == 1
    assert bench.send(sp.make_ping(1)) is not None


def test_broadcast_writes_are_obeyed_and_not_answered() -> None:
    bench = Bench(Series.HLS)
    assert bench.send(sp.make_write(BROADCAST_ID, 40, b"\x01")) is None
    assert bench.read("torque_enable") == 1


def test_secondary_id_takes_writes_only() -> None:
    bench = Bench(Series.HLS, 1)
    assert bench.send(sp.make_write(0, 40, b"\x01")) is None
    assert bench.read("torque_enable") == 0  # 0 means none
    bench.write(secondary_id=77)
    assert bench.send(sp.make_write(77, 40, b"\x01")) is None
    assert bench.read("torque_enable") == 1
    assert bench.send(sp.make_ping(77)) is None
    assert bench.send(sp.make_read(77, 40, 1)) is None


def test_reg_write_waits_for_action() -> None:
    bench = Bench(Series.HLS, position=2000)
    goal = Series.HLS.register("goal_position")
    bench.send(sp.make_reg_write(1, goal.address, goal.encode(2100)))
    bench.wait(0.5)
    assert bench.read("reg_write_pending") == 1
    assert bench.read("present_position") == 2000
    assert bench.send(sp.make_action()) is None
    bench.wait(0.5)
    assert bench.read("reg_write_pending") == 0
    assert bench.read("present_position") == 2100
    assert bench.send(sp.make_action(1)) is not None


def test_factory_restore_keeps_a_feetech_id_and_loses_a_legacy_one() -> None:
    bench = Bench(Series.HLS, 4, settings={"baud_code": 4, "max_torque": 500})
    assert bench.servo.baud == 115200
    assert bench.send(sp.make_restore(4)) is not None
    assert bench.servo.servo_id == 4
    assert (bench.read("max_torque"), bench.servo.baud) == (980, 1_000_000)
    legacy = Bench(Series.SEVEN_BOT, 3)
    legacy.send(sp.make_restore(3))
    assert legacy.servo.servo_id == 1


def test_backup_stores() -> None:
    bench = Bench(Series.HLS)
    bench.write(max_torque=500)
    assert bench.send(sp.make_backup(1)) is not None
    bench.servo.power_cycle(bench.now)
    assert bench.read("max_torque") == 500


def test_baud_code_takes_effect() -> None:
    bench = Bench(Series.HLS)
    bench.write(baud_code=4)
    assert bench.servo.baud == 115200
    bench.write(baud_code=9)  # there is no such code
    assert bench.servo.baud == 115200
    assert Bench(Series.SEVEN_BOT).servo.baud == 115200


# --- calibration -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("position", [100, 2048, 4000])
def test_calibrate_makes_the_place_2048_or_what_is_given(position: int) -> None:
    bench = Bench(Series.HLS, position=position)
    assert bench.send(sp.make_calibrate(1)) is not None
    assert bench.read("present_position") == 2048
    assert bench.read("position_offset") == position - 2048
    assert bench.send(sp.make_calibrate(1, (1000).to_bytes(2, "little"))) is not None
    assert bench.read("present_position") == 1000
    bench.servo.power_cycle(bench.now)
    assert bench.read("present_position") == 1000
    bench.write(goal_position=1100)
    bench.wait(0.5)
    assert bench.read("present_position") == 1100


@pytest.mark.parametrize(
    ("series", "firmware", "plain", "placed"),
    [
        (Series.HLS, (3, 42), True, False),
        (Series.HLS, (3, 43), True, True),
        (Series.STS_SMS, (3, 9), False, False),
        (Series.STS_SMS, (3, 10), True, True),
        (Series.STS_SMS, (2, 50), False, False),
        (Series.SCS, (0, 20), False, False),
    ],
)
def test_calibrate_by_firmware(series: Series, firmware: tuple[int, int], plain: bool, placed: bool) -> None:
    bench = Bench(series, firmware=firmware, position=500)
    assert (bench.send(sp.make_calibrate(1)) is not None) == plain
    assert (bench.send(sp.make_calibrate(1, b"\x00\x04")) is not None) == placed


def test_sts_calibrates_by_128_in_the_torque_register() -> None:
    bench = Bench(Series.STS_SMS, position=1500)
    bench.write(torque_enable=1)
    bench.write(torque_enable=128)
    assert bench.read("present_position") == 2048
    assert bench.read("torque_enable") == 1
    bench.write(torque_enable=77)
    assert bench.read("torque_enable") == 1
    hls = Bench(Series.HLS, position=1500)
    hls.write(torque_enable=128)
    assert hls.read("present_position") == 1500


# --- protection --------------------------------------------------------------------------------------------


def test_a_blocked_servo_reports_overload_and_lets_go_until_a_goal_presses_no_more() -> None:
    bench = Bench(Series.STS_SMS, position=2000)
    bench.servo.motion.obstacle = (None, 2100.0)
    bench.write(goal_position=3000)
    bench.wait(1.5)
    assert bench.read("status") == 0
    assert bench.read("present_load") == 1000
    # A stream of goals is no way around it.
    for _ in range(20):
        bench.write(goal_position=3000)
        bench.wait(0.05)
    status = bench.send(sp.make_ping(1))
    assert status is not None
    assert status.error == 0x20
    assert bench.read("present_load") == 200
    bench.write(goal_position=3000)
    bench.wait(0.1)
    assert bench.read("status") == 0x20
    bench.write(goal_position=2050)
    bench.wait(1.0)
    assert bench.read("status") == 0
    assert bench.read("present_position") == 2050


def test_torque_off_ends_an_overload() -> None:
    bench = Bench(Series.STS_SMS, position=2000)
    bench.servo.motion.obstacle = (None, 2100.0)
    bench.write(goal_position=3000)
    bench.wait(3.0)
    assert bench.read("status") == 0x20
    bench.write(torque_enable=0)
    assert bench.read("status") == 0


def test_an_hls_current_ceiling_saves_it_from_overload() -> None:
    bench = Bench(Series.HLS, position=2000)
    bench.servo.motion.obstacle = (None, 2100.0)
    bench.send(sp.make_write(1, 41, block(0, 3000, 100, 60)))
    bench.wait(5.0)
    assert bench.read("status") == 0
    assert bench.read("present_load") == 500


def test_wrong_supply_is_reported_and_takes_the_torque() -> None:
    bench = Bench(Series.HLS, position=2000, gravity=lambda shaft: 0.3)
    bench.write(torque_enable=1)
    bench.servo.supply = 12.0
    bench.wait(0.2)
    status = bench.send(sp.make_ping(1))
    assert status is not None
    assert status.error == 0x01
    assert bench.read("present_voltage") == 120
    assert bench.read("present_position") > 2050
    bench.servo.supply = 6.0
    assert bench.read("status") == 0


def test_heat_is_reported() -> None:
    bench = Bench(Series.HLS)
    bench.servo.protection.ambient = bench.servo.protection.temperature = 85.0
    bench.wait(1.0)
    assert bench.read("present_temperature") == 85
    assert bench.read("status") == 0x04


def test_legacy_servos_report_no_status() -> None:
    bench = Bench(Series.SEVEN_BOT, position=2000)
    bench.servo.motion.obstacle = (None, 2100.0)
    bench.servo.supply = 2.0
    bench.write(target_position=3000)
    bench.wait(10.0)
    status = bench.send(sp.make_ping(1))
    assert status is not None
    assert status.error == 0


# --- any bytes, any time -----------------------------------------------------------------------------------


def test_unknown_instructions_and_uneven_packets_are_not_answered() -> None:
    bench = Bench(Series.HLS)
    for packet in (
        ServoPacket(1, 0x55, b""),
        ServoPacket(1, Instruction.WRITE, b"\x28"),
        ServoPacket(1, Instruction.REG_WRITE, b"\x28"),
        ServoPacket(BROADCAST_ID, Instruction.SYNC_WRITE, b"\x28\x02\x01"),
        ServoPacket(1, Instruction.CALIBRATE, b"\x01"),
    ):
        assert bench.servo.receive(packet, 0.0) is None
    legacy = Bench(Series.SEVEN_BOT)
    assert legacy.send(sp.make_sync_read(56, 2, [1])) is None
    assert legacy.send(sp.make_reboot(1)) is None


def test_bad_ids_are_refused() -> None:
    with pytest.raises(UsageError):
        EmulatedServo(Series.HLS, 254)


@given(
    st.sampled_from(list(Series)),
    st.lists(
        st.tuples(st.sampled_from([1, 1, 1, 2, 254]), st.integers(0, 0x84), st.binary(max_size=12)), max_size=12
    ),
)
@settings(max_examples=200)
def test_any_packets_are_survived(series: Series, packets: list[tuple[int, int, bytes]]) -> None:
    servo = EmulatedServo(
        series, 1, settings={"status_return_level": 1} if series is not Series.SEVEN_BOT else None
    )
    now = 0.0
    for packet in packets:
        answer = servo.receive(ServoPacket(*packet), now)
        if answer is not None:
            sp.parse_status(answer)
        now += 0.05
        servo.step(now)
        assert -40_000 < servo.motion.position < 45_000


goals = st.lists(st.tuples(st.integers(0, 900), st.integers(0, 4095), st.integers(0, 400)), min_size=1, max_size=4)


@given(
    st.sampled_from(list(Series)),
    goals,
    st.lists(st.floats(0, 4), max_size=12),
    st.floats(-0.3, 0.3),
)
def test_how_time_is_cut_does_not_matter(
    series: Series, moves: list[tuple[int, int, int]], cuts: list[float], weight: float
) -> None:
    """The same packets at the same times give the same memory, however `step` is called in between."""
    results = []
    for steps in ([], cuts):
        servo = EmulatedServo(series, 1, position=500, gravity=lambda shaft: weight, noise=1.0)
        servo.motion.obstacle = (None, 2500.0)
        goal = series.at(42)
        assert goal is not None
        times = sorted({ms / 1000: value for ms, value, _ in moves}.items())
        agenda = [(when, True, value) for when, value in times] + [(when, False, 0) for when in steps]
        for when, is_goal, value in sorted(agenda, key=lambda entry: (entry[0], not entry[1])):
            if is_goal:
                servo.receive(ServoPacket(1, Instruction.WRITE, bytes((42,)) + goal.encode(value)), when)
            else:
                servo.step(when)
        servo.step(4.5)
        servo.refresh()
        results.append((servo.registers.read(0, 256), servo.motion.position, servo.protection.temperature))
    assert results[0] == results[1]


def test_going_back_in_time_does_nothing() -> None:
    bench = Bench(Series.HLS, position=2000)
    bench.write(goal_position=2500)
    bench.wait(0.5)
    before = bench.servo.motion.position
    bench.servo.step(0.1)
    assert bench.servo.motion.position == before


def test_a_late_start_costs_nothing() -> None:
    servo = EmulatedServo(Series.HLS, 1, position=2000, start=1e6)
    goal = Series.HLS.register("goal_position").encode(2100)
    servo.receive(ServoPacket(1, Instruction.WRITE, bytes((42,)) + goal), 1e6)
    servo.step(1e6 + 1)
    assert servo.present_position == 2100

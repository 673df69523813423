"""The leader beside LeRobot's own, on the same emulated arm."""

from __future__ import annotations

import pytest
from emulated import LOSS, bus, calibrated
from lerobot.teleoperators import make_teleoperator_from_config
from lerobot.teleoperators.so_leader import SO101Leader, SO101LeaderConfig
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError
from lerobot_robot_hexwire import (
    HexwireHex7botLeader,
    HexwireHex7botLeaderConfig,
    HexwireRemoteLeader,
    HexwireRemoteLeaderConfig,
    HexwireSO100Leader,
    HexwireSO100LeaderConfig,
    HexwireSO101Leader,
    HexwireSO101LeaderConfig,
)

from hexwire.drivers.bus_arm import So101Arm
from hexwire.emulator.hand import HandOrder
from hexwire.emulator.serve_hand import move_by_hand


@pytest.mark.parametrize(
    ("config", "kind", "joints"),
    [
        (HexwireSO101LeaderConfig(port="/dev/none"), HexwireSO101Leader, 6),
        (HexwireSO100LeaderConfig(port="/dev/none"), HexwireSO100Leader, 6),
        (HexwireRemoteLeaderConfig(port="zenoh:lab/arm1", arm="hex7bot"), HexwireRemoteLeader, 7),
        (HexwireHex7botLeaderConfig(port="/dev/none"), HexwireHex7botLeader, 7),
    ],
)
def test_lerobot_makes_each_leader_and_knows_its_joints_before_connecting(
    config: object, kind: type, joints: int
) -> None:
    leader = make_teleoperator_from_config(config)
    assert type(leader) is kind
    assert len(leader.action_features) == joints
    assert leader.feedback_features == {}
    assert not leader.is_connected
    for call in (leader.get_action, leader.disconnect):
        with pytest.raises(DeviceNotConnectedError):
            call()


@pytest.mark.parametrize("degrees", [True, False])
def test_values_and_files_are_those_of_lerobots_own_leader(leader: str, degrees: bool) -> None:
    own = SO101Leader(SO101LeaderConfig(port=leader, id="blue", use_degrees=degrees))
    ours = HexwireSO101Leader(HexwireSO101LeaderConfig(port=leader, id="blue", use_degrees=degrees))
    assert ours.calibration_fpath == own.calibration_fpath
    assert ours.action_features == own.action_features
    move_by_hand(leader, HandOrder("elbow_flex", -20.0, 0.4))
    ours.connect()
    with pytest.raises(DeviceAlreadyConnectedError):
        ours.connect()
    found = ours.get_action()
    own.calibration = ours.calibration
    counts = {
        i: round(raw)
        for i, raw in enumerate(ours._arm.driver.bus.sync_read("present_position", range(1, 7)).raw, 1)
    }
    beside = own.bus._normalize(counts)
    assert list(found.values()) == pytest.approx(list(beside.values()), abs=0.2)
    ours.disconnect()


def test_a_leader_gets_no_torque(leader: str) -> None:
    with So101Arm.from_url(leader) as arm:
        arm.torque(True)
    ours = HexwireSO101Leader(HexwireSO101LeaderConfig(port=leader, id="blue"))
    ours.connect()
    assert ours._arm.driver.read().torque_on == ()
    with pytest.raises(NotImplementedError):
        ours.send_feedback({})
    ours.disconnect()


def test_lost_answers_raise_nothing() -> None:
    with bus("--leader", "--baud", "0", *LOSS) as port:
        calibrated(port, "blue", leader=True)
        ours = HexwireSO101Leader(HexwireSO101LeaderConfig(port=port, id="blue"))
        ours.connect()
        here = ours.get_action()
        for _ in range(600):
            assert ours.get_action() == pytest.approx(here, abs=1.0)
        assert ours._arm.driver.host_counters()["repeats"] > 0
        ours.disconnect()

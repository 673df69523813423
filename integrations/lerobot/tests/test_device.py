"""What robots and leaders share, by the example of each."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from emulated import CALIBRATION
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError
from lerobot_robot_hexwire import (
    HexwireSO101,
    HexwireSO101Config,
    HexwireSO101Leader,
    HexwireSO101LeaderConfig,
)
from lerobot_robot_hexwire.device import HexwireDevice, SoDevice
from simulated import Sim

KINDS = ("follower", "leader")


@pytest.fixture
def device(request: pytest.FixtureRequest) -> Any:
    """A calibrated SO-101, not connected."""
    port = request.getfixturevalue(request.param)
    if request.param == "follower":
        return HexwireSO101(HexwireSO101Config(port=port, id="black"))
    return HexwireSO101Leader(HexwireSO101LeaderConfig(port=port, id="blue"))


@pytest.mark.parametrize("device", KINDS, indirect=True)
def test_the_life_of_a_connection(device: Any) -> None:
    assert isinstance(device, HexwireDevice)
    for call in (device.disconnect, device.calibrate):
        with pytest.raises(DeviceNotConnectedError):
            call()
    for _ in range(2):
        device.connect()
        assert device.is_connected
        assert device.is_calibrated
        with pytest.raises(DeviceAlreadyConnectedError):
            device.connect()
        device.disconnect()
        assert not device.is_connected
        with pytest.raises(DeviceNotConnectedError):
            device.disconnect()


@pytest.mark.parametrize("device", KINDS, indirect=True)
def test_a_connection_that_fails_half_way_is_closed(device: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(one: SoDevice) -> None:
        raise RuntimeError("half way")

    with monkeypatch.context() as broken:
        broken.setattr(SoDevice, "_write_settings", fail)
        with pytest.raises(RuntimeError, match="half way"):
            device.connect()
    assert not device.is_connected
    device.connect()
    device.disconnect()


@pytest.mark.parametrize("device", KINDS, indirect=True)
def test_a_joint_that_does_not_confirm_its_torque(device: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    torque = "hexwire.drivers.bus_arm.BusArm.torque"
    with monkeypatch.context() as broken:
        broken.setattr(torque, lambda arm, on, joints=None: tuple(arm.model.names[1:]))
        with pytest.raises(ConnectionError, match="shoulder_pan does not confirm torque"):
            device.connect()
    assert not device.is_connected


@pytest.mark.parametrize("device", KINDS, indirect=True)
def test_a_calibration_uses_the_file_of_its_own_kind(device: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[Path, bool]] = []
    monkeypatch.setattr(
        "lerobot_robot_hexwire.device.calibrate", lambda arm, link, file, *, auto: asked.append((file, auto))
    )
    device.connect()
    device.calibrate()
    folder, name = ("teleoperators/so_leader", "blue") if device.leads else ("robots/so_follower", "black")
    assert asked == [(CALIBRATION / folder / f"{name}.json", False)]
    assert device.is_connected
    if not device.leads:
        # Without torque it follows nothing.
        with pytest.raises(RuntimeError, match="no torque"):
            device.send_action({"shoulder_pan.pos": 0.0})
    device.disconnect()


@pytest.mark.parametrize("leader", [False, True])
def test_to_connect_takes_few_packets(monkeypatch: pytest.MonkeyPatch, leader: bool) -> None:
    """Each one is a round trip of a millisecond and more on a real adapter."""
    sim = Sim(monkeypatch, leader=leader)
    device = sim.device()
    # The first time writes what differs.
    device.connect()
    device.disconnect()
    before = len(sim.link.written)
    device.connect()
    assert len(sim.link.written) - before <= 20
    assert [servo.registers.get("torque_enable") for servo in sim.servos] == [int(not leader)] * 6
    device.disconnect()

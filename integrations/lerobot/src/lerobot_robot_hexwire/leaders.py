"""The teleoperators: arms without torque that a hand moves.

Owns LeRobot's contract of a teleoperator. Must not know servos or links.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, ClassVar

from lerobot.teleoperators import Teleoperator
from lerobot.teleoperators.so_leader import SOLeader

from .config_hexwire import (
    HexwireHex7botLeaderConfig,
    HexwireRemoteLeaderConfig,
    HexwireSO100LeaderConfig,
    HexwireSO101LeaderConfig,
    HexwireTeleopConfig,
)
from .connection import faults
from .device import HexwireDevice, RemoteDevice, SoDevice
from .robots import meet_again

__all__ = [
    "HexwireHex7botLeader",
    "HexwireLeader",
    "HexwireRemoteLeader",
    "HexwireSO100Leader",
    "HexwireSO101Leader",
]


class HexwireLeader(HexwireDevice, Teleoperator):
    """An arm of hexwire that is moved by hand; its values are those of `HexwireRobot`."""

    config_class: ClassVar[type[HexwireTeleopConfig]] = HexwireTeleopConfig

    def __init__(self, config: HexwireTeleopConfig) -> None:
        super().__init__(config)
        self._begin(config)
        self.bus = SimpleNamespace(motors=[row[0] for row in self._joints])

    @property
    def feedback_features(self) -> dict[str, type]:
        return {}

    def configure(self) -> None:
        """Switch torque off, since a joint with torque works against the hand; write settings that differ."""
        self._torque(False)
        with faults():
            self._write_settings()

    def get_action(self) -> dict[str, float]:
        """Read all joints.

        Raises:
            DeviceNotConnectedError: It is not connected.
            ConnectionError: A joint does not answer; an answer that was lost is asked for again.
            RuntimeError: It is not calibrated.
        """
        self._check_connected()
        arm = self._arm
        lost, values = arm.lost, arm.values
        state = arm.read()
        if arm.lost != lost:
            meet_again()
        return values.values(state.position)

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Not supported, as by LeRobot's own leaders.

        Raises:
            NotImplementedError: Always.
        """
        raise NotImplementedError("a leader without torque gives no feedback")


class HexwireSO101Leader(SoDevice, HexwireLeader):
    """An SO-101 leader; shares calibration files with LeRobot's own `so101_leader`."""

    config_class: ClassVar[type[HexwireTeleopConfig]] = HexwireSO101LeaderConfig
    name = SOLeader.name
    kind = "so101"
    leads = True


class HexwireSO100Leader(HexwireSO101Leader):
    """An SO-100 leader; shares calibration files with LeRobot's own `so100_leader`."""

    config_class = HexwireSO100LeaderConfig
    kind = "so100"


class HexwireHex7botLeader(HexwireLeader):
    """A Hex7Bot without torque."""

    config_class = HexwireHex7botLeaderConfig
    name = "hexwire_hex7bot_leader"
    kind = "hex7bot"


class HexwireRemoteLeader(RemoteDevice, HexwireLeader):
    """A leader that `hexwire serve` shares, anywhere on the network."""

    config_class = HexwireRemoteLeaderConfig
    name = "hexwire_remote_leader"

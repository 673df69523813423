"""Robots and teleoperators of hexwire in LeRobot.

Owns the names that LeRobot looks up: it imports this package because of its name, which registers the
configurations, and finds the class of `XConfig` as `X` here.
"""

from .bimanual import BiHexwireSO101, BiHexwireSO101Leader
from .config_hexwire import (
    BiHexwireSO101Config,
    BiHexwireSO101LeaderConfig,
    HexwireGamepadConfig,
    HexwireHex7botConfig,
    HexwireHex7botLeaderConfig,
    HexwireKeyboardConfig,
    HexwireRemoteConfig,
    HexwireRemoteLeaderConfig,
    HexwireSO100Config,
    HexwireSO100LeaderConfig,
    HexwireSO101Config,
    HexwireSO101LeaderConfig,
)
from .guides import HexwireGamepad, HexwireKeyboard
from .leaders import HexwireHex7botLeader, HexwireRemoteLeader, HexwireSO100Leader, HexwireSO101Leader
from .robots import HexwireHex7bot, HexwireRemote, HexwireSO100, HexwireSO101

__all__ = [
    "BiHexwireSO101",
    "BiHexwireSO101Config",
    "BiHexwireSO101Leader",
    "BiHexwireSO101LeaderConfig",
    "HexwireGamepad",
    "HexwireGamepadConfig",
    "HexwireHex7bot",
    "HexwireHex7botConfig",
    "HexwireHex7botLeader",
    "HexwireHex7botLeaderConfig",
    "HexwireKeyboard",
    "HexwireKeyboardConfig",
    "HexwireRemote",
    "HexwireRemoteConfig",
    "HexwireRemoteLeader",
    "HexwireRemoteLeaderConfig",
    "HexwireSO100",
    "HexwireSO100Config",
    "HexwireSO100Leader",
    "HexwireSO100LeaderConfig",
    "HexwireSO101",
    "HexwireSO101Config",
    "HexwireSO101Leader",
    "HexwireSO101LeaderConfig",
]

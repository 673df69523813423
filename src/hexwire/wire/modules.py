"""Module ids and channel kinds of the chapter, with their strings.

Owns the two enumerations. Knows nothing of configuration files or links.
"""

from __future__ import annotations

from enum import IntEnum

__all__ = ["IpcType", "ModuleType", "module_name"]


class ModuleType(IntEnum):
    """The chapter's ModuleType_e: sender and receiver of a frame."""

    INVALID_MODULE = -1
    ROS1_HOST = 0
    JOY_STICK = 1
    PUMA260_HOST_IO_TRX = 2
    PUMA260_RBT_IO_SVR = 3
    PUMA260_HOST_JNT_CMD_TX = 4
    PUMA260_HOST_JSTATE_RX = 5
    PUMA260_HOST_JTRAJ_TX = 6
    ARM_7BOT_SERIAL_TRX = 7
    ARM_7BOT_ARDUINO_TRX = 8


class IpcType(IntEnum):
    """The chapter's Ipctype_e: the kind of channel."""

    QUEUE = 0
    TCP = 1
    UDP = 2
    SERIAL = 3


_NAMES = {member.value: member.name for member in ModuleType}


def module_name(module_id: int) -> str:
    """Return the name of a module id, or ``module 42`` for an id that the chapter does not have."""
    return _NAMES.get(module_id) or f"module {module_id}"

"""Module ids and channel kinds of the chapter, with their strings; module types of one's own.

Owns the two enumerations and the names of registered modules. Knows nothing of configuration files or links, nor
where other packages keep their modules (`hexwire.ipc.channel`).
"""

from __future__ import annotations

import re
from enum import IntEnum
from typing import Any

from hexwire.errors import UsageError

__all__ = [
    "LAST_MODULE_TYPES",
    "MAX_MODULE",
    "TOTAL_IPC_TYPES",
    "IpcType",
    "ModuleType",
    "known_modules",
    "module_name",
    "module_named",
    "register_module",
]

MAX_MODULE = 2**30 - 1
"""Largest module id; the bits above have other uses in a frame's destination."""

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,63}")


class ModuleType(IntEnum):
    """ModuleType_e: sender and receiver of a frame.

    Every id up to `MAX_MODULE` is a value, as in ``ModuleType(12)``; one that nobody has registered has its number
    as name.
    """

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

    @classmethod
    def _missing_(cls, value: object) -> Any:
        if type(value) is not int or not 0 <= value <= MAX_MODULE:
            return None
        member = int.__new__(cls, value)
        member._name_, member._value_ = str(value), value
        # The first one stays: two threads may ask for the same id at once, and members are compared by identity.
        return cls._value2member_map_.setdefault(value, member)

    def __reduce_ex__(self, protocol: object) -> Any:
        # By its number: before 3.11.4 Python asks for the name, which a class has only for its own members.
        return type(self), (self.value,)


class IpcType(IntEnum):
    """Ipctype_e: the kind of channel. Its spellings name the same members."""

    QUEUE = 0
    TCP = 1
    UDP = 2
    SERIAL = 3
    IPC_QUEUE = QUEUE
    IPC_TCP_SOCKET = TCP
    IPC_UDP_SOCKET = UDP
    IPC_SERIAL_PORT = SERIAL


LAST_MODULE_TYPES = max(ModuleType) + 1
"""LastModuleTypes: the first id for a module of one's own."""

TOTAL_IPC_TYPES = len(IpcType)

_named = {module.name: module for module in ModuleType}


def register_module(name: str, number: int) -> ModuleType:
    """Give an id a name, for configuration files and displays. Twice the same is harmless.

    Args:
        name: Letters, digits and ``_``; must not start with a digit.
        number: `LAST_MODULE_TYPES` to `MAX_MODULE`. Ids up to 29 can be addressed together in one frame.

    Returns:
        The module, to be used like a member of `ModuleType`.

    Raises:
        UsageError: The name or the id is invalid, or belongs to another module.
    """
    if not _NAME.fullmatch(name):
        raise UsageError(f"a module cannot be called {name!r}: letters, digits and _ are needed, no digit first")
    if type(number) is not int or not LAST_MODULE_TYPES <= number <= MAX_MODULE:
        raise UsageError(
            f"module {name} cannot have the id {number!r}: ids are {LAST_MODULE_TYPES} to {MAX_MODULE}"
        )
    module = ModuleType(number)
    before = _named.get(name)
    if before is not None and before is not module:
        raise UsageError(f"module {name} has the id {int(before)} already")
    if module.name not in (name, str(number)):
        raise UsageError(f"module id {number} is {module.name} already, not {name}")
    module._name_ = name
    _named[name] = module
    return module


def module_named(name: str) -> ModuleType | None:
    """The module of a name, a member of `ModuleType` or registered; None if there is none."""
    module = _named.get(name)
    return None if module is ModuleType.INVALID_MODULE else module


def known_modules() -> tuple[ModuleType, ...]:
    """All modules that have a name, by id: those of `ModuleType`, then those registered."""
    return tuple(sorted(module for module in _named.values() if module is not ModuleType.INVALID_MODULE))


def module_name(module_id: int) -> str:
    """Return the name of a module id, or ``module 42`` for an id without a name."""
    module = ModuleType._value2member_map_.get(module_id)
    return module.name if module is not None and module.name in _named else f"module {module_id}"

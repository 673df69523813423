"""Module ids and strings of the chapter, and modules of one's own."""

from __future__ import annotations

import copy
import pickle

import pytest

from hexwire.errors import UsageError
from hexwire.wire import tables
from hexwire.wire.modules import (
    LAST_MODULE_TYPES,
    MAX_MODULE,
    TOTAL_IPC_TYPES,
    IpcType,
    ModuleType,
    known_modules,
    module_name,
    module_named,
    register_module,
)


def test_ids_and_strings_are_the_chapters() -> None:
    assert {m.name: m.value for m in ModuleType} == tables.MODULES
    assert [m.value for m in ModuleType] == list(range(-1, 9))
    assert {m.name: m.value for m in IpcType} == {"QUEUE": 0, "TCP": 1, "UDP": 2, "SERIAL": 3}
    assert (LAST_MODULE_TYPES, TOTAL_IPC_TYPES) == (9, 4)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("IPC_QUEUE", IpcType.QUEUE),
        ("IPC_TCP_SOCKET", IpcType.TCP),
        ("IPC_UDP_SOCKET", IpcType.UDP),
        ("IPC_SERIAL_PORT", IpcType.SERIAL),
    ],
)
def test_the_chapters_spellings_name_the_same_kinds(name: str, kind: IpcType) -> None:
    assert IpcType[name] is kind


@pytest.mark.parametrize("module", ModuleType)
def test_names(module: ModuleType) -> None:
    assert module_name(module) == module.name


def test_an_unknown_id_still_has_words() -> None:
    assert module_name(42) == "module 42"
    assert ModuleType(42).name == "42"
    assert module_name(42) == "module 42"


@pytest.mark.parametrize("value", [-2, MAX_MODULE + 1, "9", 9.5, True])
def test_what_is_no_module_id(value: object) -> None:
    with pytest.raises(ValueError, match="not a valid ModuleType"):
        ModuleType(-2 if value is True else value)


def test_a_module_of_ones_own() -> None:
    before = ModuleType(21)
    gripper = register_module("GRIPPER_TRX", 21)
    assert (gripper, gripper.name, module_name(21)) == (21, "GRIPPER_TRX", "GRIPPER_TRX")
    assert gripper is before
    assert gripper is module_named("GRIPPER_TRX")
    assert gripper in known_modules()
    assert register_module("GRIPPER_TRX", 21) is gripper
    # It is like the chapter's in every way, but does not change the chapter's list.
    assert pickle.loads(pickle.dumps(gripper)) is gripper
    assert copy.deepcopy(gripper) is gripper
    assert gripper not in list(ModuleType)


@pytest.mark.parametrize(
    ("name", "number", "words"),
    [
        ("MINE", 8, "ids are 9 to"),
        ("MINE", MAX_MODULE + 1, "ids are 9 to"),
        ("MINE", True, "ids are 9 to"),
        ("ROS1_HOST", 9, "has the id 0 already"),
        ("INVALID_MODULE", 9, "has the id -1 already"),
        ("9TH", 9, "cannot be called"),
        ("A B", 9, "cannot be called"),
        ("", 9, "cannot be called"),
        ("TWICE_B", 22, "module id 22 is TWICE_A already"),
        ("TWICE_A", 23, "TWICE_A has the id 22 already"),
    ],
)
def test_what_cannot_be_registered(name: str, number: int, words: str) -> None:
    register_module("TWICE_A", 22)
    with pytest.raises(UsageError, match=words):
        register_module(name, number)
    assert module_name(23) == "module 23"


def test_nobody_finds_the_invalid_module_by_name() -> None:
    assert module_named("INVALID_MODULE") is None
    assert ModuleType.INVALID_MODULE not in known_modules()

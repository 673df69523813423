"""Module ids and strings of the chapter."""

from __future__ import annotations

import pytest

from hexwire.errors import UsageError
from hexwire.wire import tables
from hexwire.wire.modules import IpcType, ModuleType, module_name, parse_module


def test_ids_and_strings_are_the_chapters() -> None:
    assert {m.name: m.value for m in ModuleType} == tables.MODULES
    assert [m.value for m in ModuleType] == list(range(-1, 9))
    assert {m.name: m.value for m in IpcType} == {"QUEUE": 0, "TCP": 1, "UDP": 2, "SERIAL": 3}


@pytest.mark.parametrize("module", ModuleType)
def test_name_and_back(module: ModuleType) -> None:
    assert module_name(module) == module.name
    assert parse_module(f" {module.name}\n") is module


def test_an_unknown_id_still_has_words() -> None:
    assert module_name(42) == "module 42"


@pytest.mark.parametrize("text", ["", "ROS2_HOST", "ros1_host", "7", "__class__"])
def test_an_unknown_name_is_refused_with_what_is_known(text: str) -> None:
    with pytest.raises(UsageError, match="ARM_7BOT_SERIAL_TRX") as caught:
        parse_module(text)
    assert repr(text) in str(caught.value)
    assert "INVALID" not in str(caught.value)

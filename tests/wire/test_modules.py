"""Module ids and strings of the chapter."""

from __future__ import annotations

import pytest

from hexwire.wire import tables
from hexwire.wire.modules import IpcType, ModuleType, module_name


def test_ids_and_strings_are_the_chapters() -> None:
    assert {m.name: m.value for m in ModuleType} == tables.MODULES
    assert [m.value for m in ModuleType] == list(range(-1, 9))
    assert {m.name: m.value for m in IpcType} == {"QUEUE": 0, "TCP": 1, "UDP": 2, "SERIAL": 3}


@pytest.mark.parametrize("module", ModuleType)
def test_names(module: ModuleType) -> None:
    assert module_name(module) == module.name


def test_an_unknown_id_still_has_words() -> None:
    assert module_name(42) == "module 42"

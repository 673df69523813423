"""Destinations: one module, several, all."""

from __future__ import annotations

import pytest

from hexwire.errors import UsageError
from hexwire.wire.addresses import Address, Broadcast, Multicast, Unicast, address_of, destination_name, module_id
from hexwire.wire.modules import ModuleType


@pytest.mark.parametrize(
    ("address", "dst"),
    [
        (Unicast(8), 8),
        (Unicast(0x3FFFFFFF), 0x3FFFFFFF),
        (Multicast([8]), 0x40000100),
        (Multicast([0, 29]), 0x60000001),
        (Multicast(range(30)), 0x7FFFFFFF),
        (Broadcast(), -1),
    ],
)
def test_each_address_has_one_value(address: Address, dst: int) -> None:
    assert address.dst == dst
    assert address_of(dst) == address


@pytest.mark.parametrize("dst", [-2, -(2**31), 0x40000000])
def test_other_values_are_nobodys(dst: int) -> None:
    assert address_of(dst) is None


def test_who_is_meant() -> None:
    assert [m for m in range(40) if Unicast(8).names(m)] == [8]
    assert [m for m in range(40) if Multicast([29, 3]).names(m)] == [3, 29]
    assert all(Broadcast().names(m) for m in range(40))


@pytest.mark.parametrize("modules", [[], [30], [-1], [8, 31]])
def test_a_multicast_names_at_least_one_of_thirty(modules: list[int]) -> None:
    with pytest.raises(UsageError, match="0 to 29"):
        Multicast(modules)


def test_modules_by_name_and_number() -> None:
    assert module_id("ARM_7BOT_ARDUINO_TRX") == module_id("arm_7bot_arduino_trx") == module_id("8") == 8
    assert module_id(ModuleType.JOY_STICK) == 1
    for wrong in ("", "INVALID_MODULE", "-1", "eight", "1.0", "9" * 30, -1, 1 << 30):
        with pytest.raises(UsageError, match="module"):
            module_id(wrong)


def test_words_for_a_log() -> None:
    assert str(Multicast([8, 9])) == "ARM_7BOT_ARDUINO_TRX, module 9"
    assert str(Broadcast()) == "all modules"
    assert str(Unicast(1)) == "JOY_STICK"
    assert [destination_name(dst) for dst in (8, 0x40000300, -1, -5)] == [
        "ARM_7BOT_ARDUINO_TRX",
        "ARM_7BOT_ARDUINO_TRX, module 9",
        "all modules",
        "module -5",
    ]

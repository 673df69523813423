"""Modules that another package brings, found without a change to hexwire."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from tests.packages import install as install_package

from hexwire.errors import ConfigError, UsageError
from hexwire.ipc import channel as channels
from hexwire.ipc.conf import parse_conf, to_conf
from hexwire.ipc.handle import IpcHandle
from hexwire.wire.modules import module_name

Install = Callable[[str, str, str], None]
"""Name of the package, its code, and what its entry point names."""
RECORD = "{} CLIENT_TRX ARM_7BOT_ARDUINO_TRX SERIAL /dev/ttyUSB0\n"


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Puts a package where the interpreter finds it, as pip does."""
    monkeypatch.syspath_prepend(tmp_path)

    def put(name: str, code: str, attribute: str) -> None:
        entries = {channels.ENTRY_POINT_GROUP: {"all": f"{name}:{attribute}"}}
        install_package(tmp_path, name, entries, {f"{name}.py": code})
        channels._load_modules.cache_clear()

    yield put
    sys.modules.pop("own_modules_a", None)
    channels._load_modules.cache_clear()


def test_an_enumeration_of_another_package(install: Install) -> None:
    with pytest.raises(ConfigError, match="unknown module_name 'CAMERA_TX'; known: ROS1_HOST"):
        parse_conf(RECORD.format("CAMERA_TX"))
    code = "from enum import IntEnum\nclass Ids(IntEnum):\n    CAMERA_TX = 24\n    LIFT_TRX = 25\n"
    install("own_modules_a", code, "Ids")
    (channel,) = parse_conf(RECORD.format("CAMERA_TX"))
    assert (channel.module, channel.module.name) == (24, "CAMERA_TX")
    assert module_name(25) == "LIFT_TRX"
    assert parse_conf(to_conf([channel])) == [channel]


def test_a_mapping_of_another_package(install: Install) -> None:
    install("own_modules_b", "IDS = {'SCALE_TX': 26}\n", "IDS")
    channels.load_own_modules()
    assert module_name(26) == "SCALE_TX"


def test_a_destination_behind_a_gateway(install: Install) -> None:
    install("own_modules_f", "IDS = {'TURNTABLE_TRX': 27}\n", "IDS")
    assert IpcHandle.from_url("tcp://127.0.0.1:15040?to=TURNTABLE_TRX").destination == 27


@pytest.mark.parametrize(
    ("name", "code", "words"),
    [
        ("own_modules_c", "IDS = 5\n", "neither an enumeration nor a mapping"),
        ("own_modules_d", "IDS = {'SCALE_RX': 8}\n", "ids are 9 to"),
        ("own_modules_e", "IDS = {'SCALE_RX': '9'}\n", "ids are 9 to"),
    ],
)
def test_a_package_that_is_wrong(install: Install, name: str, code: str, words: str) -> None:
    install(name, code, "IDS")
    with pytest.raises(UsageError, match=words):
        channels.load_own_modules()

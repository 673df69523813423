"""Exceptions of the wire in hexwire: nothing that `except HexwireError` caught before escapes it."""

from __future__ import annotations

from pathlib import Path

import pytest

from hexwire import errors
from hexwire.ros2.wire import RouterSettings, own_errors
from zenoh_ros2 import errors as ros


@pytest.mark.parametrize(
    ("kind", "own"),
    [
        (ros.LocalProtocolError, errors.LocalProtocolError),
        (ros.ServiceTimeoutError, errors.LinkTimeoutError),
        (ros.ProtocolError, errors.ProtocolError),
        (ros.RemoteProtocolError, errors.RemoteProtocolError),
        (ros.RosError, errors.HexwireError),
        (ros.RouterNotFoundError, errors.LinkNotFoundError),
        (ros.SessionClosedError, errors.LinkClosedError),
        (ros.SessionError, errors.LinkPermissionError),
        (ros.UsageError, errors.UsageError),
    ],
)
def test_each_becomes_one_of_hexwire_with_its_text(
    kind: type[ros.RosError], own: type[errors.HexwireError]
) -> None:
    with pytest.raises(own) as caught, own_errors():
        raise kind("why it is so")
    assert type(caught.value) is own
    assert str(caught.value) == "why it is so"
    assert caught.value.__suppress_context__


def test_every_kind_is_known() -> None:
    known = {kind for kind in vars(ros).values() if isinstance(kind, type) and issubclass(kind, ros.RosError)}
    for kind in known - {ros.RosError}:
        with pytest.raises(errors.HexwireError) as caught, own_errors():
            raise kind("why")
        assert type(caught.value) is not errors.HexwireError, kind


def test_a_file_of_settings_is_read_within_the_bounds_of_hexwire(tmp_path: Path) -> None:
    with pytest.raises(errors.ConfigError, match="is a pipe or a device"):
        RouterSettings(config_file="/dev/zero").read_config_file()
    path = tmp_path / "zenoh.json5"
    path.write_bytes(b"\xff\xfe{")
    with pytest.raises(errors.ConfigError, match="UTF-16"):
        RouterSettings(config_file=str(path)).read_config_file()

from __future__ import annotations

import dataclasses
from typing import Any

import pytest
from tests.studio.servos.conftest import servo_of

from hexwire.bus.backup import parse_backups, serialize_backups
from hexwire.errors import ConfigError, UsageError
from hexwire.studio.servos import backup


def test_a_backup_is_taken_compared_and_survives_a_file(view: Any) -> None:
    rows = backup.taken(view, (1, 3))
    assert [row.servo_id for row in rows] == [1, 3]
    assert rows[0].taken
    assert backup.differences(view, rows[1]) == []
    servo_of(view, 3).registers.put_stored("max_temperature", 50)
    assert backup.differences(view, rows[1]) == [("max_temperature", 50, 70)]
    assert backup.differences(view, dataclasses.replace(rows[1], servo_id=99)) is None
    assert parse_backups(serialize_backups(rows).encode(), "x") == rows
    with pytest.raises(UsageError, match="search first"):
        backup.taken(view, ())


@pytest.mark.parametrize(
    "data", [b"", b"{}", b"\xff\xfe", b"[1]", b'{"format": "hexwire servo settings 1", "servos": 3}']
)
def test_what_is_no_backup_is_refused(data: bytes) -> None:
    with pytest.raises(ConfigError):
        parse_backups(data, "the file")

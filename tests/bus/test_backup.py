from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.bus.bus_bench import make_bus

from hexwire.bus import backup as backups
from hexwire.bus.setup import write_setting
from hexwire.errors import ConfigError, ServoError, UsageError
from hexwire.wire.registers import Series


@pytest.mark.parametrize("series", list(Series))
def test_there_and_back_over_a_file(series: Series, tmp_path: Path) -> None:
    bus, _ = make_bus((1, 2), (series,))
    saved = backups.take_backup(bus, 1, taken="2026-01-02T03:04:05+00:00")
    (tmp_path / "b.json").write_text(backups.serialize_backups([saved]), encoding="utf-8")
    assert backups.load_backup(tmp_path / "b.json") == [saved]
    assert list(tmp_path.iterdir()) == [tmp_path / "b.json"]
    assert saved.series == series.value
    assert saved.registers["id"] == 1
    assert backups.compare(saved, saved) == []


def test_what_was_changed_is_put_back_but_never_id_and_rate() -> None:
    bus, _ = make_bus((1, 2))
    saved = backups.take_backup(bus, 1)
    write_setting(bus, 2, "position_p", 50)
    write_setting(bus, 2, "max_temperature", 55)
    now = backups.take_backup(bus, 2)
    assert [row[0] for row in backups.compare(now, saved)] == ["id", "max_temperature", "position_p"]
    odd = replace(saved, registers={**saved.registers, "baud_code": 4})
    assert backups.restore_backup(bus, 2, odd) == ["max_temperature", "position_p"]
    assert bus.ping(2).ok
    assert bus.read(2, "position_p").raw == saved.registers["position_p"]
    assert bus.read(2, "lock").raw == 1


def test_a_backup_of_another_series_is_refused() -> None:
    bus, _ = make_bus((1, 2), (Series.STS_SMS, Series.SCS), paced=False)
    saved = backups.take_backup(bus, 1)
    with pytest.raises(UsageError, match="of a sts_sms servo, and servo 2 is scs"):
        backups.restore_backup(bus, 2, saved)
    wild = replace(saved, registers={**saved.registers, "max_temperature": 200})
    with pytest.raises(UsageError, match="max_temperature = 200"):
        backups.restore_backup(bus, 1, wild)
    with pytest.raises(ServoError):
        backups.take_backup(bus, 9)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "{",
        '{"format": "hexwire servo settings 1"}',
        '{"format": "hexwire servo settings 1", "servos": [3]}',
    ],
)
def test_other_files_are_refused_with_their_name(text: str, tmp_path: Path) -> None:
    file = tmp_path / "x.json"
    file.write_text(text)
    with pytest.raises(ConfigError, match=r"x\.json"):
        backups.load_backup(file)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.recursive(st.none() | st.integers() | st.text(), lambda x: st.lists(x) | st.dictionaries(st.text(), x)))
def test_any_content_is_a_backup_or_a_named_error(tmp_path: Path, content: object) -> None:
    file = tmp_path / "any.json"
    file.write_text(json.dumps({"format": "hexwire servo settings 1", "servos": content}))
    try:
        rows = backups.load_backup(file)
    except ConfigError:
        return
    assert rows == []

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
from hexwire.wire.servo_packet import make_status


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


def test_the_faults_of_all_servos_of_a_file_are_told_together() -> None:
    good = backups.ServoBackup(1, "sts_sms", "3.10", "sts3215", "", {"id": 1})
    rows = [replace(good, series="x"), good, replace(good, registers={"id": 300})]
    with pytest.raises(ConfigError) as caught:
        backups.parse_backups(backups.serialize_backups(rows).encode(), "f")
    kinds = ", ".join(series.value for series in Series)
    assert str(caught.value) == (
        f"f: servos[0].series must be one of {kinds}, not the text 'x'; "
        "servos[2].registers.id is 300, but must be 0 to 255"
    )


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


def test_differences_name_what_is_on_either_side_only() -> None:
    one = backups.ServoBackup(1, "sts_sms", "3.10", "sts3215", "", {"id": 1, "position_p": 2})
    other = replace(one, registers={"position_p": 3, "lock": 1, "id": 1})
    assert backups.compare(one, other) == [("position_p", 2, 3), ("lock", None, 1)]


def test_values_at_a_registers_ends_are_put_back_and_beyond_them_not() -> None:
    bus, _ = make_bus((1,))
    saved = backups.take_backup(bus, 1)
    # With 0 it reports at once that it is too hot, which must not keep anybody from putting that right.
    for value in (0, 100):
        odd = replace(saved, registers={"max_temperature": value})
        assert backups.restore_backup(bus, 1, odd) == ["max_temperature"]
        bus.pause(1.0)
        reading = bus.read(1, "max_temperature")
        assert (reading.raw, reading.ok) == (value, value == 100)
    for value in (-1, 101):
        with pytest.raises(UsageError, match=f"max_temperature = {value}, .*nothing was changed"):
            backups.restore_backup(bus, 1, replace(saved, registers={"max_temperature": value}))
    assert backups.restore_backup(bus, 1, replace(saved, registers={"max_temperature": 100})) == []


def test_a_servo_that_does_not_take_a_setting_is_named() -> None:
    bus, device = make_bus((1,))
    saved = backups.take_backup(bus, 1)
    plain = device.wire[1].receive
    device.wire[1].receive = lambda packet, now: (
        make_status(1) if packet.instruction == 3 and packet.params[:1] == b"\x0d" else plain(packet, now)
    )
    odd = replace(saved, registers={"max_temperature": 61, "position_p": 9})
    with pytest.raises(ServoError, match=r"^servo 1 did not take max_temperature$"):
        backups.restore_backup(bus, 1, odd)
    assert bus.read(1, "position_p").raw == 9
    assert bus.read(1, "lock").raw == 1

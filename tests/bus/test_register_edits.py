from __future__ import annotations

import pytest
from tests.bus.bus_bench import make_bus

from hexwire.bus.registers import MOVING, Edit, RegisterEdits, parse_value, why_not
from hexwire.errors import ServoError, UsageError
from hexwire.wire.registers import Series

STS = Series.STS_SMS
ALL = (Series.SEVEN_BOT, Series.SCS, Series.STS_SMS, Series.HLS)


@pytest.mark.parametrize(
    ("name", "text", "raw", "value"),
    [
        ("max_temperature", "65", False, 65),
        ("max_temperature", " 0x41 ", True, 65),
        ("max_torque", "50", False, 500),
        ("max_torque", "49,9", False, 499),
        ("min_position_limit", "90", False, 1024),
        ("overload_time", "1.5", False, 150),
        ("mode", "3", False, 3),
        ("position_offset", "-10", False, -114),
    ],
)
def test_what_a_person_types(name: str, text: str, raw: bool, value: int) -> None:
    assert parse_value(STS.register(name), text, raw=raw) == value


@pytest.mark.parametrize(
    ("name", "text", "raw", "words"),
    [
        ("max_temperature", "hot", False, "is not a number in °C"),
        ("max_temperature", "65.5", True, "is not a whole number"),
        ("max_temperature", "", True, "is not a whole number"),
        ("max_temperature", "101", False, "takes 0..100 °C, not 101"),
        ("max_temperature", "nan", False, "is not a number"),
        ("max_temperature", "1e999", False, "is not a number"),
        ("max_temperature", "9" * 5000, True, "is not a whole number"),
        ("max_torque", "101", False, "takes 0..100 %, not 101"),
        ("max_torque", "1001", True, "takes 0..1000, not 1001"),
        ("mode", "4", False, "takes 0..3, not 4"),
        ("mode", "1.0", False, "is not a whole number"),
        ("acceleration", "1e30", False, "cannot hold"),
    ],
)
def test_what_is_refused_before_anything_is_sent(name: str, text: str, raw: bool, words: str) -> None:
    with pytest.raises(UsageError, match=words.replace(".", r"\.")):
        parse_value(STS.register(name), text, raw=raw)


@pytest.mark.parametrize("series", ALL)
def test_what_moves_or_loses_a_servo_is_not_edited_as_a_number(series: Series) -> None:
    closed = {name for name, register in series.registers.items() if register.access == "rw" and why_not(register)}
    assert closed == ({"id", "baud_code", "lock", "torque_enable"} | MOVING) & {
        name for name, register in series.registers.items() if register.access == "rw"
    }
    bus, _ = make_bus((4,), (series,), paced=False)
    before = len(bus.link.written)  # type: ignore[attr-defined]
    for name in closed:
        with pytest.raises(UsageError, match=name):
            RegisterEdits().prepare(bus, 4, name, "1", raw=True)
    assert len(bus.link.written) == before  # type: ignore[attr-defined]


def test_no_write_of_an_open_register_moves_a_servo_or_changes_its_address() -> None:
    for series in (Series.SCS, Series.STS_SMS, Series.HLS):
        for name, register in series.registers.items():
            if register.access != "rw" or why_not(register) or name in ("mode", "phase"):
                continue
            bus, device = make_bus((4,), (series,), paced=False)
            there = device.wire[4].motion.position
            high = register.maximum if register.maximum is not None else 1
            bus.write_raw(4, name, high)
            bus.pause(0.5)
            assert device.wire[4].registers.get("torque_enable") == 0, name
            assert device.wire[4].motion.position == pytest.approx(there, abs=2), name


def test_an_edit_is_stored_verified_and_undone() -> None:
    bus, device = make_bus((4,))
    edits = RegisterEdits()
    stored = device.wire[4].registers.stored
    edit = edits.prepare(bus, 4, "max_temperature", "60", raw=False)
    assert (edit.before, edit.after, edit.stored) == (70, 60, True)
    assert stored("max_temperature") == 70, "only prepared"
    edits.apply(bus, edit)
    assert stored("max_temperature") == 60
    second = edits.prepare(bus, 4, "acceleration", "10", raw=True)
    edits.apply(bus, second)
    assert not second.stored
    assert [str(row) for row in edits.done] == [
        "servo 4 max_temperature: 70 → 60",
        "servo 4 acceleration: 0 → 10",
    ]
    assert edits.undo(bus) == second
    assert edits.undo(bus) == edit
    assert (stored("max_temperature"), bus.read(4, "acceleration").raw) == (70, 0)
    assert bus.read(4, "lock").raw == 1
    with pytest.raises(UsageError, match="nothing to undo"):
        edits.undo(bus)


def test_nothing_is_written_over_a_change_that_somebody_else_made() -> None:
    bus, device = make_bus((4,))
    edits = RegisterEdits()
    edit = edits.prepare(bus, 4, "max_temperature", "60", raw=False)
    device.wire[4].registers.put_stored("max_temperature", 50)
    with pytest.raises(ServoError, match="changed since it was shown: it is 50, not 70"):
        edits.apply(bus, edit)
    edit = edits.prepare(bus, 4, "max_temperature", "60", raw=False)
    edits.apply(bus, edit)
    device.wire[4].registers.put_stored("max_temperature", 55)
    with pytest.raises(ServoError, match="changed since that edit"):
        edits.undo(bus)
    assert list(edits.done) == [edit]
    assert device.wire[4].registers.stored("max_temperature") == 55


def test_a_value_that_the_servo_does_not_take_is_no_edit() -> None:
    bus, device = make_bus((4,))
    edits = RegisterEdits()
    device.wire[4].registers.write = lambda address, data: set()  # type: ignore[method-assign]
    for name in ("max_temperature", "acceleration"):
        edit = edits.prepare(bus, 4, name, "60", raw=True)
        with pytest.raises(ServoError, match=f"has .*{name}|{name}"):
            edits.apply(bus, edit)
    assert not edits.done


def test_limits_must_leave_a_range() -> None:
    bus, _ = make_bus((4,))
    edits = RegisterEdits()
    edits.apply(bus, edits.prepare(bus, 4, "max_position_limit", "2000", raw=True))
    with pytest.raises(UsageError, match="leaves no range, the other limit is 2000"):
        edits.prepare(bus, 4, "min_position_limit", "2000", raw=True)
    assert edits.prepare(bus, 4, "min_position_limit", "1999", raw=True).after == 1999
    with pytest.raises(UsageError, match="leaves no range, the other limit is 40"):
        edits.prepare(bus, 4, "max_voltage", "3.5", raw=False)


def test_what_is_asked_before_an_edit() -> None:
    def warning(name: str) -> str:
        return Edit(4, STS.register(name), 0, 1).warning

    assert warning("position_p") == "position_p is stored in servo 4 and survives power-off"
    assert "run away" in warning("phase")
    assert warning("acceleration") == ""


def test_the_history_is_bounded_and_follows_an_id() -> None:
    edits = RegisterEdits()
    for i in range(300):
        edits.done.append(Edit(4 if i % 2 else 5, STS.register("mode"), 0, 1))
    assert len(edits.done) == 100
    edits.moved(4, 9)
    assert {edit.servo_id for edit in edits.done} == {5, 9}
    assert edits.done.maxlen == 100


def test_a_silent_servo_is_named() -> None:
    bus, device = make_bus((4,))
    device.wire.servos = []
    with pytest.raises(ServoError, match="servo 4"):
        RegisterEdits().prepare(bus, 4, "position_p", "20", raw=True)

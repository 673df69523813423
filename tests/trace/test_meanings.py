from __future__ import annotations

from hexwire.trace.explain import BODY, FRAME, body_meaning, flag_words, register_meaning
from hexwire.wire import tables as t
from hexwire.wire.registers import Series


def test_every_field_of_every_body_and_header_has_a_meaning() -> None:
    fields = {
        (name, field[0])
        for name, row in t.COMMAND_ROWS.items()
        for body in (row.request, row.reply)
        for field in (*body.fields, *body.rows)
    }
    assert len(fields) > 80
    silent = [field for field in fields if not body_meaning(*field).text]
    assert not silent
    assert set(BODY) <= {field for _, field in fields}
    assert {name for name, _, _ in t.HEADER_FIELDS} <= set(FRAME)
    assert set(t.COMMAND_DOCS) == set(t.COMMAND_ROWS)


def test_a_field_may_mean_something_else_in_another_body() -> None:
    assert body_meaning("STOP", "mode").names == {0: "hold", 1: "torque off"}
    assert body_meaning("ROBOT_MODE", "mode").names == {0: "position", 1: "teach"}


def test_flags_have_names_and_unknown_bits_a_number() -> None:
    assert flag_words(0x03, t.BOARD_FLAGS) == "stopped, watchdog tripped"
    assert flag_words(0x81, t.BOARD_FLAGS) == "stopped, 0x80"
    assert flag_words(0, t.BOARD_FLAGS) == "none"


def test_a_register_says_whether_it_is_stored_and_what_it_takes() -> None:
    lock = Series.HLS.at(55)
    assert register_meaning(lock) == (
        "Not stored, read and write, 0 to 1, from the factory 1. 0 = EEPROM writes persist, 1 = protected."
    )
    assert register_meaning(Series.STS_SMS.at(9)).startswith("Stored, read and write, 0 to 4094")
    assert "bit 15 is the sign" in register_meaning(Series.STS_SMS.at(58))
    assert register_meaning(None) == ""

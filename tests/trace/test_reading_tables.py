"""The tables of the decoder and the analysers."""

from __future__ import annotations

from hexwire.trace.reading_tables import TABLES
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import Instruction


def test_registers_are_those_of_the_series() -> None:
    assert set(TABLES["series"]) == {series.value for series in Series}
    for series in Series:
        rows = TABLES["series"][series.value]["registers"]
        assert {row[0]: at for at, row in rows.items()} == {
            register.name: register.address for register in series.registers.values()
        }
    assert TABLES["series"]["hls"]["registers"][42] == ("goal_position", 2, 15, "count", 360 / 4096)


def test_names_are_words() -> None:
    assert TABLES["instructions"][Instruction.SYNC_READ] == "sync read"
    assert TABLES["statuses"][1] == "bad length"
    assert TABLES["board_errors"][5] == "ping silent"
    assert set(TABLES["bare"]) <= set(TABLES["instructions"])
    assert TABLES["commands"][0x1A]["name"] == "TRANSACT"

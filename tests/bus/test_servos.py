from __future__ import annotations

import pytest

from hexwire.bus.servos import KnownServos, as_series
from hexwire.bus.timing import RETURN_DELAY
from hexwire.errors import UsageError
from hexwire.wire.registers import Series


def test_series_by_name() -> None:
    assert as_series("hls") is Series.HLS
    assert as_series(Series.SCS) is Series.SCS
    with pytest.raises(UsageError, match="there are seven_bot, scs, sts_sms, hls"):
        as_series("stx")


def test_a_servo_is_of_the_default_series_unless_something_else_is_known() -> None:
    servos = KnownServos("sts_sms", {7: "scs"})
    assert servos.default is Series.STS_SMS
    assert servos.series_of(1) is Series.STS_SMS
    assert servos.series_of(7) is Series.SCS
    servos.set_series(1, "seven_bot")
    assert servos.series_of(1) is Series.SEVEN_BOT
    with pytest.raises(UsageError, match="no servo series"):
        KnownServos("sts_sms", {7: "stx"})


def test_return_delays_add_up() -> None:
    servos = KnownServos("sts_sms")
    servos.set_return_delay(2, 0.0001)
    assert servos.return_delays((1, 2)) == pytest.approx(RETURN_DELAY + 0.0001)
    assert servos.return_delays(()) == 0


def test_a_legacy_servo_never_acknowledges_and_others_do_until_known_otherwise() -> None:
    servos = KnownServos("sts_sms", {7: "seven_bot"})
    assert servos.acknowledges(1)
    assert not servos.acknowledges(7)
    servos.set_acknowledges(1, False)
    assert not servos.acknowledges(1)
    servos.set_acknowledges(1, True)
    assert servos.acknowledges(1)


def test_where_the_registers_of_a_series_end() -> None:
    servos = KnownServos("sts_sms", {7: "seven_bot"})
    for servo_id in (1, 7):
        registers = servos.series_of(servo_id).registers.values()
        assert servos.end_of(servo_id) == max(r.address + r.size for r in registers)

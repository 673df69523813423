from __future__ import annotations

import math

import pytest
from tests.bus.bus_bench import lose_reads, make_bus

from hexwire.bus.setup import scan
from hexwire.bus.survey import _SETTINGS, survey
from hexwire.wire.registers import Series


def test_each_servo_is_told_with_what_is_wrong_with_it() -> None:
    series = (Series.STS_SMS, Series.STS_SMS, Series.HLS, Series.SEVEN_BOT)
    bus, device = make_bus((1, 2, 3, 4), series, paced=False)
    device.wire[2].supply = 12.1
    device.wire[2].registers.put("firmware_minor", 9)
    bus.pause(0.1)
    one, two, hls, legacy = survey(bus, scan(bus, ids=range(6)))
    assert [row.found.servo_id for row in (one, two, hls, legacy)] == [1, 2, 3, 4]
    assert (one.kind, one.supply) == ("7.4 V", pytest.approx(7.4, abs=0.2))
    assert one.settings == {"max_voltage": 8.0, "min_voltage": 4.0, "mode": 0.0}
    text = " ".join(remark.text for remark in two.remarks)
    assert "older than 3.10" in text
    assert "supply 12.1 V is above" in text
    assert two.bad
    # The other one has another firmware.
    assert "different firmware (3.10, 3.9)" in " ".join(remark.text for remark in one.remarks)
    assert not hls.bad
    assert (legacy.kind, legacy.settings, legacy.remarks) == ("", {}, [])
    assert math.isnan(legacy.supply)


def test_servos_that_share_an_id_or_are_at_another_rate_are_only_listed() -> None:
    bus, device = make_bus((1, 9, 9))
    device.wire[1].registers.put("baud_code", 4)
    found = scan(bus, bauds=(1_000_000, 115_200), ids=range(12))
    before = len(bus.link.written)  # type: ignore[attr-defined]
    both, other = survey(bus, found)
    assert (both.found.servo_id, both.found.shared, other.found.baud) == (9, True, 115_200)
    assert both.bad
    assert "several servos" in both.remarks[0].text
    assert other.settings == {}
    assert len(bus.link.written) == before  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", _SETTINGS)
def test_a_setting_that_was_not_read_is_said_to_be_unknown(name: str) -> None:
    bus, device = make_bus((1, 2), paced=False)
    lose_reads(device.wire[2], name)
    one, two = survey(bus, scan(bus, ids=range(4)))
    assert name in one.settings
    assert name not in two.settings
    assert (one.bad, two.bad) == (False, True)
    assert [remark.text for remark in two.remarks] == [
        f"did not answer when {name} was read: check its cable, try again"
    ]

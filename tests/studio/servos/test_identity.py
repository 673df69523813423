from __future__ import annotations

from typing import Any

import pytest
from tests.studio.servos.conftest import Bench, servo_of

from hexwire.errors import HexwireError, ServoError, StoppedError, UsageError
from hexwire.studio.servos import identity


def test_a_changed_servo_is_followed_with_its_edits(view: Any) -> None:
    edits = view.bus.edits
    edits.apply(view.bus.bus, edits.prepare(view.bus.bus, 6, "max_temperature", "60", raw=False))
    told: list[str] = []
    identity.change(view, 6, 20, 115_200, told.append)
    assert len(told) == 4
    assert (servo_of(view, 20).registers.stored("id"), view.bus.bus.timing.baud) == (20, 115_200)
    assert view.bus.bench.servo_ids == (20,), "the others are at the old rate"
    assert [row.found.baud for row in view.bus.servos].count(1_000_000) == 5
    assert edits.undo(view.bus.bus).servo_id == 20


def test_a_line_without_a_rate_offers_none_that_it_could_not_follow() -> None:
    assert list(identity.rates(0, [1_000_000, 115_200])) == [0]
    assert list(identity.rates(500_000, [115_200, 500_000])) == [500_000, 115_200]
    assert identity.rates(115_200, []) == {115_200: "the rate of this series is fixed"}


def test_a_bad_id_is_refused_on_the_server(view: Any) -> None:
    for new_id in (-1, 254, 10_000):
        with pytest.raises(UsageError, match="outside"):
            identity.change(view, 6, new_id, 1_000_000, lambda words: None)
    view.bus.stop("enough")
    with pytest.raises(StoppedError):
        identity.change(view, 6, 20, 1_000_000, lambda words: None)
    assert servo_of(view, 6).registers.stored("id") == 6


def test_a_servo_that_was_cut_off_is_found_again(view: Any) -> None:
    servo = servo_of(view, 6)
    plain = servo.receive
    # Its supply fails as soon as it has its new id.
    servo.receive = lambda packet, now: plain(packet, now) if servo.registers.get("id") == 6 else None  # type: ignore[method-assign]
    with pytest.raises(HexwireError, match="neither to 6 nor to 20"):
        identity.change(view, 6, 20, 1_000_000, lambda words: None)
    with pytest.raises(ServoError, match="switch its supply off and on"):
        identity.look(view, (6, 20), (1_000_000, 1_000_000))
    servo.receive = plain  # type: ignore[method-assign]
    assert identity.look(view, (6, 20), (1_000_000, 1_000_000)).servo_id == 20
    assert view.bus.bench.servo_ids == (1, 2, 3, 4, 5, 20)


@pytest.mark.slow
def test_the_id_is_changed_and_the_servo_followed(bench: Bench) -> None:
    page = bench.page
    page.get_by_role("button", name="Servo 6", exact=True).click()
    bench.part("Id and rate")
    page.get_by_label("New id").fill("3")
    bench.button("Change").click()
    bench.button("Change it").click()
    page.get_by_text("id 3 is taken: nothing was changed").wait_for()
    page.get_by_label("New id").fill("20")
    bench.button("Change").click()
    bench.button("Change it").click()
    page.get_by_role("heading", name="Servo 20", level=2).wait_for()
    assert bench.servo(20).registers.stored("id") == 20
    assert bench.bus.bench.servo_ids == (1, 2, 3, 4, 5, 20)

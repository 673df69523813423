from __future__ import annotations

import pytest

from hexwire.bus.plan import PlanCache, writable
from hexwire.bus.servos import KnownServos
from hexwire.bus.timing import RETURN_DELAY, LineTiming
from hexwire.errors import UsageError
from hexwire.wire.registers import Series

POSITION = "present_position"


def make_cache(series: dict[int, str] | None = None) -> PlanCache:
    return PlanCache(KnownServos("sts_sms", series), LineTiming(1_000_000))


def test_a_read_is_planned_once_with_the_time_it_takes_on_the_wire() -> None:
    cache = make_cache({2: "seven_bot"})
    plan, register = cache.read(1, POSITION)
    assert cache.reads[1, POSITION] == (plan, register)
    assert plan.base == pytest.approx(16 * 10e-6 + RETURN_DELAY)
    assert register.name == POSITION
    assert cache.read(1, "present_temperature")[0].count == 1
    assert cache.read(2, "present_temperature")[0].count == 2, "all that a legacy servo knows"
    with pytest.raises(UsageError, match="present_postion"):
        cache.read(1, "present_postion")


def test_servos_that_are_alike_share_a_sync_read() -> None:
    cache = make_cache({3: "scs"})
    plan = cache.sync(POSITION, (1, 2))
    assert plan is not None
    assert plan.base == pytest.approx(plan.total * 10e-6 + 2 * RETURN_DELAY)
    assert cache.sync(POSITION, (1, 2)) is plan
    assert cache.sync(POSITION, (1, 3)) is None
    assert cache.sync(POSITION, (1, 3)) is None, "from the cache too"
    with pytest.raises(UsageError, match="at least one servo"):
        cache.sync(POSITION, ())


def test_a_part_of_a_sync_read_is_the_same_register_or_a_block_around_it() -> None:
    cache = make_cache()
    plan = cache.sync(POSITION, (1, 2, 3))
    assert plan is not None
    again = cache.part(plan, (1, 3), plan.address, plan.count)
    assert again is cache.sync(POSITION, (1, 3))
    around = cache.part(plan, (1, 3), plan.address, plan.count + 1)
    assert (around.register, around.count) == (None, 3)
    assert cache.block(plan.address, 3, (1, 3)) is around
    for address in range(200):
        for count in (1, 2, 4):
            cache.block(address, count, (1,))
    assert len(cache._blocks) <= 512


def test_a_sync_write_is_for_a_register_that_all_have_alike() -> None:
    cache = make_cache({3: "scs"})
    plan = cache.sync_write("goal_position", (1, 2))
    assert plan is cache.sync_writes["goal_position", (1, 2)]
    assert cache.sync_write("goal_position", (1, 3)) is None
    assert cache.sync_write("torque_enable", (1, 2)) is None
    with pytest.raises(UsageError, match="at least one servo"):
        cache.sync_write("goal_position", ())
    with pytest.raises(UsageError, match="is read-only"):
        cache.sync_write(POSITION, (1,))


def test_nothing_planned_outlives_another_rate() -> None:
    cache = make_cache()
    cache.read(1, POSITION)
    before = cache.sync(POSITION, (1, 2))
    block = cache.block(56, 2, (1, 2))
    cache.sync_write("goal_position", (1, 2))
    cache.clear(LineTiming(115_200))
    assert not cache.reads
    assert not cache.sync_writes
    after = cache.sync(POSITION, (1, 2))
    assert before is not None
    assert after is not None
    assert after.base > before.base
    assert cache.block(56, 2, (1, 2)) is not block


def test_read_only_registers_are_not_written() -> None:
    assert writable(Series.STS_SMS, 4, "goal_position").name == "goal_position"
    with pytest.raises(UsageError, match="register present_position of servo 4 is read-only"):
        writable(Series.STS_SMS, 4, POSITION)


def test_errors_name_the_servo() -> None:
    with pytest.raises(UsageError, match="register present_position of servo 7 is read-only"):
        make_cache().sync_write(POSITION, (7, 1))
    assert make_cache({3: "scs"}).sync_write("goal_position", (3,)) is not None
    assert make_cache({3: "scs"}).sync(POSITION, (3,)) is None, "an SCS servo knows no sync read"
    assert make_cache().sync(POSITION, (3,)) is not None


def test_a_part_in_the_same_place_but_of_another_length_is_a_block() -> None:
    cache = make_cache()
    plan = cache.sync(POSITION, (1, 2, 3))
    assert plan is not None
    for address, count in ((plan.address - 1, plan.count), (plan.address, 3)):
        part = cache.part(plan, (1, 2), address, count)
        assert (part.address, part.count, part.ids, part.register) == (address, count, (1, 2), None)
        assert part.base == pytest.approx(part.total * 10e-6 + 2 * RETURN_DELAY)

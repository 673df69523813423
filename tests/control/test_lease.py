"""The rules of an arm's lease, with a clock of the test's own."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from hexwire.control.sharing.lease import Grant, Lease
from hexwire.errors import LeaseError


def make() -> Lease:
    return Lease(new_key=itertools.count(1).__next__)


def test_a_lease_that_nobody_holds_is_granted_and_only_its_key_commands() -> None:
    lease = make()
    grant = lease.take("Ann", 1, 10.0)
    assert lease.admit(grant.key, 1, 10.1) is grant
    with pytest.raises(LeaseError, match="Ann holds the lease") as caught:
        lease.admit(grant.key + 1, 1, 10.1)
    assert caught.value.holder == "Ann"
    assert caught.value.lost
    assert lease.counters.without_lease == 1


def test_keys_differ_and_are_no_small_numbers() -> None:
    lease = Lease()
    keys = {lease.take("Ann", 1, 0.0, force=True).key for _ in range(100)}
    assert len(keys) == 100
    assert min(keys) > 0
    assert max(keys) <= 2**53
    assert min(keys).bit_length() > 30


def test_a_heartbeat_and_an_order_renew_it_and_silence_ends_it() -> None:
    lease = make()
    key = lease.take("Ann", 1, 0.0).key
    lease.beat(key, 0.4)
    lease.admit(key, 1, 0.8)
    assert lease.due == pytest.approx(1.3)
    assert lease.expire(1.29) is None
    lost = lease.expire(1.3)
    assert lost is not None
    assert lost.key == key
    assert lease.ended == "Ann lost the lease after 0.5 s of silence"
    assert lease.counters.lost == 1
    for call in (lambda: lease.beat(key, 1.3), lambda: lease.admit(key, 2, 1.3)):
        with pytest.raises(LeaseError, match="Ann lost the lease after"):
            call()


def test_a_heartbeat_that_comes_late_does_not_revive_it_though_nobody_has_looked() -> None:
    lease = make()
    key = lease.take("Ann", 1, 0.0).key
    with pytest.raises(LeaseError, match="was lost after"):
        lease.beat(key, 3.0)
    with pytest.raises(LeaseError, match="was lost after"):
        lease.admit(key, 1, 3.0)
    assert not lease.is_alive(3.0)
    assert lease.expire(3.0) is not None


def test_every_method_sees_the_same_end_of_a_lease() -> None:
    lease = make()
    key = lease.take("Ann", 1, 0.0).key
    assert lease.is_alive(0.25)
    assert lease.check(key, 0.25).key == key
    assert lease.due == 0.5
    assert not lease.is_alive(0.5)
    with pytest.raises(LeaseError):
        lease.check(key, 0.5)
    assert lease.expire(0.5) is not None


def test_a_longer_time_out_is_kept_to() -> None:
    lease = Lease(timeout=2.0)
    key = lease.take("Ann", 1, 0.0).key
    lease.beat(key, 1.9)
    assert lease.expire(3.8) is None
    assert lease.expire(3.9) is not None


def test_only_who_may_takes_it_from_a_holder() -> None:
    lease = make()
    lease.take("Ann", 2, 0.0)
    with pytest.raises(LeaseError, match=r"Ann holds the lease; wait .* --take"):
        lease.take("Bob", 2, 0.1)
    with pytest.raises(LeaseError, match="your role may not take it"):
        lease.take("Bob", 1, 0.1, force=True)
    grant = lease.take("Eve", 2, 0.1, force=True)
    assert lease.holder is grant
    assert lease.counters.preempted == 1


def test_it_is_taken_from_a_former_holder_as_long_as_another_one_has_it() -> None:
    lease = make()
    key = lease.take("Ann", 1, 0.0).key
    assert not lease.taken_from(key)
    assert not lease.taken_from(0), "who never had it has lost nothing"
    lease.revoke("Eve took it")
    assert lease.taken_from(key) == "Eve took it", "before Eve has it, the arm holds for her"
    eve = lease.take("Eve", 2, 0.1)
    assert lease.taken_from(key) == "Eve holds the lease"
    assert not lease.taken_from(eve.key)
    lease.leave(eve.key, 0.2, -math.inf)
    assert not lease.taken_from(key), "nobody has it"
    lease.take("Bob", 1, 0.3)
    assert lease.taken_from(key)


def test_each_refusal_has_its_own_counter() -> None:
    lease = make()
    key = lease.take("Ann", 1, 0.0).key
    lease.admit(key, 5, 0.1, age=0.25)
    for call, text in (
        (lambda: lease.admit(key, 5, 0.1), "order 5 came after order 5"),
        (lambda: lease.admit(key, 4, 0.1), "order 4 came after order 5"),
        (lambda: lease.admit(key, 6, 0.1, age=0.26), "260 ms old, more than 250 ms"),
        (lambda: lease.admit(key, 6, 0.1, age=0.0), "order 6 came after order 6"),
        (lambda: lease.admit(key, 7, 0.1, age=0.0, doubt=0.26), "age of the set-point is not known"),
    ):
        with pytest.raises(LeaseError, match=text) as caught:
            call()
        assert not caught.value.lost, "the lease is still theirs"
    counters = lease.counters
    assert (counters.out_of_order, counters.too_old, counters.undated, counters.without_lease) == (3, 1, 1, 0)


@pytest.mark.parametrize(
    ("age", "doubt"),
    [
        (math.nan, 0.0),
        (0.0, math.nan),
        (math.inf, 0.0),
        (-math.inf, 0.0),
        (0.0, math.inf),
        (math.inf, math.inf),
        (0.0, -0.1),
        (100.0, 100.0),
        (-0.01, 0.0),
        (-1e300, 0.25),
    ],
)
def test_a_set_point_of_unknown_age_is_refused(age: float, doubt: float) -> None:
    lease = make()
    key = lease.take("Ann", 1, 0.0).key
    with pytest.raises(LeaseError):
        lease.admit(key, 1, 0.1, age, doubt)
    assert lease.counters.undated + lease.counters.too_old == 1
    assert lease.holder is not None
    assert lease.holder.heard == 0.0, "it is no sign of life"


def test_an_age_counts_as_its_least_value() -> None:
    lease = make()
    key = lease.take("Ann", 1, 0.0).key
    lease.admit(key, 1, 0.1, age=0.34, doubt=0.1)
    with pytest.raises(LeaseError, match="260 ms old"):
        lease.admit(key, 2, 0.1, age=0.36, doubt=0.1)


@pytest.mark.parametrize("idle", [math.nan, -1e300, -0.0, 0.0])
def test_an_idle_time_that_is_none_counts_as_no_idle_time(idle: float) -> None:
    lease = make()
    key = lease.take("Ann", 1, 0.0).key
    assert lease.beat(key, 0.2, idle).active == 0.2


@pytest.mark.parametrize("idle", [0.3, 1e300, math.inf])
def test_an_idle_time_never_takes_back_what_was_heard(idle: float) -> None:
    lease = make()
    key = lease.take("Ann", 1, 0.0).key
    assert lease.beat(key, 0.2, idle).active == 0.0


def test_a_former_holder_gets_the_reason_even_after_another_holder() -> None:
    lease = make()
    ann = lease.take("Ann", 1, 0.0).key
    lease.revoke("Bob took it from Ann")
    bob = lease.take("Bob", 1, 0.1).key
    lease.leave(bob, 0.2)
    for key, why in ((ann, "Bob took it from Ann"), (bob, "holds no lease")):
        with pytest.raises(LeaseError, match=why):
            lease.beat(key, 0.3)
    eve = lease.take("Eve", 1, 0.4).key
    lease.expire(5.0)
    for key, why in ((eve, "Eve lost the lease"), (ann, "holds no lease")):
        with pytest.raises(LeaseError, match=why):
            lease.beat(key, 5.1)


def test_a_holder_that_leaves_during_its_motion_waits_for_nobody() -> None:
    lease = make()
    key = lease.take("Ann", 2, 0.0).key
    lease.leave(key, 0.1, 5.0)
    assert lease.holder is not None
    assert lease.holder.finishing
    assert lease.is_alive(4.9)
    for call in (lambda: lease.beat(key, 0.2), lambda: lease.admit(key, 1, 0.2)):
        with pytest.raises(LeaseError, match="holds no lease"):
            call()
    # Neither force nor rank is needed.
    assert lease.take("Bob", 0, 0.3).client == "Bob"
    assert lease.counters.preempted == 0


def test_a_motion_that_ends_ends_the_lease_without_a_loss() -> None:
    lease = make()
    lease.leave(lease.take("Ann", 2, 0.0).key, 0.1, 5.0)
    assert lease.expire(5.0) is None
    assert lease.holder is None
    assert (lease.ended, lease.counters.lost) == ("", 0)


def test_nobody_else_gives_it_back() -> None:
    lease = make()
    former = lease.take("Ann", 1, 0.0).key
    lease.take("Bob", 1, 0.0, force=True)
    lease.leave(former, 0.1)
    assert lease.holder is not None
    assert lease.holder.client == "Bob"


class Rules(RuleBasedStateMachine):
    """Clients that do what they like, judged by a model that only remembers who was granted what and heard when."""

    @initialize()
    def begin(self) -> None:
        self.lease, self.now = make(), 0.0
        self.grants: list[Grant] = []
        self.heard = self.ends = -math.inf
        self.key = 0
        self.numbers: dict[int, int] = {}
        self.refused = {"without_lease": 0, "too_old": 0, "undated": 0, "out_of_order": 0}

    @property
    def held(self) -> bool:
        return bool(self.key) and self.ends == -math.inf and self.now < self.heard + 0.5

    @rule(seconds=st.sampled_from([0.0, 0.05, 0.2, 0.499, 0.5, 0.6, 3.0]))
    def wait(self, seconds: float) -> None:
        self.now += seconds

    @rule()
    def look(self) -> None:
        lost = self.lease.expire(self.now)
        fell_silent = bool(self.key) and self.ends == -math.inf and self.now >= self.heard + 0.5
        assert (lost is not None) == fell_silent
        if fell_silent or self.now >= self.ends > -math.inf:
            self.key, self.ends = 0, -math.inf

    @rule(rank=st.integers(0, 2), force=st.booleans())
    def take(self, rank: int, force: bool) -> None:
        self.look()
        holder = self.lease.holder
        free = holder is None or self.ends > -math.inf
        allowed = free or (force and holder is not None and rank >= holder.rank)
        try:
            grant = self.lease.take(f"client {len(self.grants)}", rank, self.now, force=force)
        except LeaseError:
            assert not allowed
            return
        assert allowed
        assert grant.key not in [former.key for former in self.grants]
        self.grants.append(grant)
        self.key, self.heard, self.ends = grant.key, self.now, -math.inf
        self.numbers[grant.key] = 0

    @precondition(lambda self: self.grants)
    @rule(data=st.data(), number=st.integers(-1, 12), age=st.sampled_from([None, 0.0, 0.25, 0.3, math.nan]))
    def order(self, data: st.DataObject, number: int, age: float | None) -> None:
        key = data.draw(st.sampled_from([grant.key for grant in self.grants] + [0, 10**6]))
        mine = self.held and key == self.key
        why = ""
        if not mine:
            why = "without_lease"
        elif number <= self.numbers[key]:
            why = "out_of_order"
        else:
            self.numbers[key] = number
            if age is not None and math.isnan(age):
                why = "undated"
            elif age is not None and age > 0.25:
                why = "too_old"
        if why:
            with pytest.raises(LeaseError) as caught:
                self.lease.admit(key, number, self.now, age)
            assert caught.value.lost == (why == "without_lease")
            self.refused[why] += 1
        else:
            self.lease.admit(key, number, self.now, age)
            self.heard = self.now

    @precondition(lambda self: self.grants)
    @rule(data=st.data())
    def beat(self, data: st.DataObject) -> None:
        key = data.draw(st.sampled_from([grant.key for grant in self.grants]))
        try:
            self.lease.beat(key, self.now)
        except LeaseError:
            assert not (self.held and key == self.key)
        else:
            assert self.held
            assert key == self.key
            self.heard = self.now

    @precondition(lambda self: self.grants)
    @rule(data=st.data(), more=st.sampled_from([-1.0, 0.0, 0.3, 2.0]))
    def leave(self, data: st.DataObject, more: float) -> None:
        key = data.draw(st.sampled_from([grant.key for grant in self.grants]))
        mine = self.held and key == self.key
        self.lease.leave(key, self.now, self.now + more)
        if mine and more > 0:
            self.ends = self.now + more
        elif mine:
            self.key = 0

    @invariant()
    def agrees_with_the_model(self) -> None:
        lease = self.lease
        accepted = []
        for grant in self.grants:
            try:
                accepted.append(lease.check(grant.key, self.now).key)
            except LeaseError:
                continue
        assert accepted == ([self.key] if self.held else []), "one holder at most, and no former one"
        for why, count in self.refused.items():
            assert getattr(lease.counters, why) == count
        if lease.holder is not None:
            assert lease.holder.sequence == self.numbers[lease.holder.key]


TestRules = Rules.TestCase
TestRules.settings = settings(max_examples=60, stateful_step_count=40)


def test_only_the_key_of_the_holder_keeps_the_lease() -> None:
    lease = Lease(timeout=0.5)
    grant = lease.take("Ann", 1, 0.0)
    lease.admit(grant.key, 7, 0.1)
    assert lease.keep(grant.key, 0.4) is grant
    assert (grant.sequence, grant.heard, lease.counters.preempted) == (7, 0.4, 0)
    assert lease.keep(grant.key ^ 1, 0.4) is None
    assert lease.keep(0, 0.4) is None
    lease.leave(grant.key, 0.4, 5.0)
    assert lease.keep(grant.key, 0.5) is None, "it has left"
    lease = Lease(timeout=0.5)
    assert lease.keep(lease.take("Ann", 1, 0.0).key, 0.6) is None, "it was lost"


def test_a_stop_voids_the_orders_made_before_it_but_not_torque_off() -> None:
    lease = make()
    key = lease.take("Ann", 1, 0.0).key
    lease.void(key, 3)
    with pytest.raises(LeaseError, match="order 2 was made before a stop"):
        lease.admit(key, 2, 0.1)
    assert lease.admit(key, 2, 0.1, frees=True).sequence == 2
    with pytest.raises(LeaseError, match="order 3 was made before a stop"):
        lease.admit(key, 3, 0.1)
    lease.admit(key, 4, 0.1)

"""Which calls a stop voids; what threads and signal handlers make of it is in tests/property/test_stops.py."""

from __future__ import annotations

import threading

import pytest

from hexwire.epochs import Epochs, Token
from hexwire.errors import HexwireError, LeaseError, PreemptedError, StoppedError


def test_a_stop_voids_what_was_called_before_it_and_nothing_else() -> None:
    epochs = Epochs()
    before = epochs.token("a move")
    epochs.check(before, "a move")
    with epochs.stopping():
        assert not epochs.holds(before)
    with pytest.raises(StoppedError, match=r"a move was not sent: a stop came after the call"):
        epochs.check(before, "a move")
    # The arm is stopped now, which its board tells; this side lets it be asked.
    after = epochs.token("a move")
    epochs.check(after, "a move")
    epochs.resumed(epochs.token("resume", freeing=True))
    with pytest.raises(StoppedError, match="called while the arm was stopped"):
        epochs.check(after, "a move")
    with pytest.raises(StoppedError, match="a stop came after the call, and is over; call it again"):
        epochs.check(before, "a move")
    epochs.check(epochs.token("a move"), "a move")


def test_while_a_stop_is_under_way_nothing_but_torque_off_can_be_called_from_elsewhere() -> None:
    epochs = Epochs()
    inside, over = threading.Event(), threading.Event()

    def stop() -> None:
        with epochs.stopping():
            inside.set()
            over.wait(30)

    thread = threading.Thread(target=stop)
    thread.start()
    assert inside.wait(30)
    for freeing in (False, True):
        with pytest.raises(StoppedError, match="is being stopped"):
            epochs.token("anything", freeing=freeing)
    with epochs.torque_off():
        epochs.check_leaving(epochs.token("torque off", freeing=True), "torque off")
    with pytest.raises(StoppedError, match="is being stopped"):
        epochs.token("a move")
    with pytest.raises(StoppedError, match="is being stopped"):
        epochs.token("resume", freeing=True)
    over.set()
    thread.join(30)
    assert epochs.stopped


def test_a_stop_that_was_not_confirmed_refuses_all_until_resume() -> None:
    epochs = Epochs()
    with pytest.raises(OSError, match="lost"), epochs.stopping():
        raise OSError("lost")
    with pytest.raises(StoppedError, match="not confirmed"):
        epochs.token("a move")
    resume = epochs.token("resume", freeing=True)
    epochs.resumed(resume)
    epochs.token("a move")
    assert not epochs.stopped


def test_a_stop_that_was_not_confirmed_has_failed_until_resume() -> None:
    epochs = Epochs()
    assert not epochs.failed
    with epochs.stopping():
        epochs.unconfirmed()
    assert epochs.failed
    epochs.resumed(epochs.token("resume", freeing=True))
    assert not epochs.failed
    with epochs.stopping():
        pass
    assert not epochs.failed


def test_a_later_stop_that_is_confirmed_makes_up_for_one_that_was_not() -> None:
    epochs = Epochs()
    with epochs.stopping():
        epochs.unconfirmed()
    with epochs.stopping():
        pass
    epochs.check(epochs.token("a move"), "a move")


def test_a_resume_ends_only_the_stops_before_it() -> None:
    epochs = Epochs()
    with epochs.stopping():
        pass
    resume = epochs.token("resume", freeing=True)
    with epochs.stopping():
        pass
    with pytest.raises(StoppedError):
        epochs.check(resume, "resume")
    epochs.resumed(resume)
    assert epochs.stopped


def test_all_of_a_call_is_of_one_time_in_whatever_thread_it_is_done() -> None:
    epochs = Epochs()
    with epochs.calling("a move") as call:
        assert epochs.token("a part of it") is call.token
        with epochs.stopping():
            assert epochs.token("what the stop sends").urgent
        with pytest.raises(StoppedError):
            epochs.check(epochs.token("a part of it"), "a part of it")
    assert epochs.of_this_call is None
    epochs.forget()
    with epochs.using(call.token), pytest.raises(StoppedError):
        epochs.check(epochs.token("a job"), "a job")


def test_a_stop_wakes_who_waits() -> None:
    epochs = Epochs()
    woken: list[int] = []
    epochs.on_stop(lambda: woken.append(1))
    with epochs.stopping():
        assert woken == [1]


def test_calls_between_two_stops_share_their_token_and_no_stop_keeps_it() -> None:
    epochs = Epochs()
    first = epochs.token("a move")
    assert epochs.token("a move") is first
    with epochs.stopping():
        pass
    held = epochs.token("a move")
    assert held.stopped
    assert not epochs.holds(first)
    epochs.resumed(held)
    after = epochs.token("a move")
    assert after is not first
    assert after == Token(held.epoch, False, voided=held.voided, limp=held.limp)
    assert epochs.holds(after)
    assert not epochs.holds(first)
    assert not epochs.holds(held)


def test_what_waited_too_long_is_refused_right_before_its_bytes_leave_and_not_later() -> None:
    epochs = Epochs()
    why: list[HexwireError] = [LeaseError("too old")]
    token = epochs.mark()._replace(late=lambda: why[0] if why else None)
    # Also asked while an answer is awaited.
    assert epochs.holds(token)
    epochs.check(token, "a move")
    with pytest.raises(LeaseError, match="too old"):
        epochs.check_leaving(token, "a move")
    with epochs.stopping(), pytest.raises(StoppedError, match="a stop came"):
        epochs.check_leaving(token, "a move")
    why.clear()
    epochs.check_leaving(epochs.mark()._replace(late=token.late), "a move")


def test_a_token_with_a_condition_is_refused_with_the_error_of_the_condition() -> None:
    epochs = Epochs()
    why: list[HexwireError] = []
    token = epochs.mark()._replace(refusal=lambda: why[0] if why else None)
    assert epochs.holds(token)
    epochs.check(token, "a move")
    why.append(LeaseError("Ann lost the lease"))
    assert not epochs.holds(token)
    with pytest.raises(LeaseError, match="Ann lost the lease"):
        epochs.check(token, "a move")
    with epochs.stopping(), pytest.raises(StoppedError, match="a stop came"):
        epochs.check(token, "a move")
    # A stop asks nobody.
    epochs.check(token._replace(urgent=True), "a stop")


def test_a_call_is_undisturbed_until_something_may_refuse_it() -> None:
    """Only then nobody else is asked before its bytes leave."""

    def stop(epochs: Epochs) -> None:
        with epochs.stopping():
            pass

    def switch_off(epochs: Epochs) -> None:
        with epochs.torque_off():
            pass

    for disturb in (stop, switch_off, Epochs.assume_stopped, Epochs.void):
        epochs = Epochs()
        token = epochs.token("a move")
        assert epochs.undisturbed(token)
        disturb(epochs)
        assert not epochs.undisturbed(token)
    epochs = Epochs()
    token = epochs.mark()
    for asked in (("refusal",), ("late",), ("refusal", "late")):
        assert not epochs.undisturbed(token._replace(**dict.fromkeys(asked, lambda: None))), asked


def test_a_stop_that_is_assumed_voids_what_was_begun_before() -> None:
    epochs = Epochs()
    token = epochs.token("motion")
    epochs.assume_stopped()
    assert not epochs.holds(token)
    with pytest.raises(StoppedError):
        epochs.check(token, "motion")


def test_each_stop_that_is_assumed_voids_what_was_begun_before_it() -> None:
    epochs = Epochs()
    epochs.assume_stopped()
    token = epochs.token("motion")
    assert epochs.holds(token)
    epochs.assume_stopped()
    assert not epochs.holds(token)


def test_a_stop_that_fails_as_it_begins_is_not_confirmed_and_no_longer_under_way() -> None:
    epochs = Epochs()

    def fail() -> None:
        raise OSError("no descriptor")

    epochs.on_stop(fail)
    with pytest.raises(OSError, match="no descriptor"), epochs.stopping():
        raise AssertionError("the stop began")
    assert epochs.failed
    with pytest.raises(StoppedError, match="not confirmed"):
        epochs.token("a move")
    epochs.token("resume", freeing=True)


def test_a_stop_that_no_call_made_voids_what_was_asked_for_before_it_and_begins_no_epoch() -> None:
    epochs = Epochs()
    before, marked = epochs.token("a move"), epochs.mark()
    epochs.void()
    assert not epochs.stopped
    for token in (before, marked):
        assert not epochs.holds(token)
        for check in (epochs.check, epochs.check_leaving):
            with pytest.raises(StoppedError, match="a stop came after the call"):
                check(token, "a move")
    after = epochs.token("a move")
    epochs.check_leaving(after, "a move")
    assert epochs.token("a move") is after, "until the next stop"
    # A stop of the host that is under way, or that nobody has resumed yet, is not ended by it.
    with epochs.stopping():
        epochs.void()
        assert epochs.stopped
        assert epochs.holds(epochs.token("the stop itself"))
    assert epochs.stopped
    waits = epochs.token("torque off", freeing=True)
    epochs.void()
    assert not epochs.holds(waits)
    epochs.resumed(epochs.token("resume", freeing=True))
    assert not epochs.stopped


def test_each_stop_has_another_number() -> None:
    epochs = Epochs()
    numbers = [epochs.number]
    with epochs.stopping():
        numbers.append(epochs.number)
    for stop in (epochs.void, epochs.assume_stopped, epochs.void):
        stop()
        numbers.append(epochs.number)
    epochs.forget()
    assert numbers == [0, 1, 2, 3, 4]
    assert epochs.number == 4


def test_torque_off_voids_what_was_asked_before_but_neither_itself_nor_what_frees_the_arm() -> None:
    epochs = Epochs()
    motion, resume = epochs.mark(), epochs.token("resume", freeing=True)
    order = epochs.mark()
    with epochs.using(order):
        with epochs.torque_off():
            first = epochs.token("torque off", freeing=True)
            # Another thread does the same.
            with epochs.using(None), epochs.torque_off():
                pass
            epochs.check_leaving(first, "torque off")
        # What comes after it in the same call is not asked for after the other one.
        with pytest.raises(StoppedError, match="torque was switched off after the call"):
            epochs.check(epochs.token("torque on"), "torque on")
    with pytest.raises(StoppedError, match="torque was switched off after the call"):
        epochs.check_leaving(motion, "a move")
    assert epochs.limp_since(motion)
    assert not epochs.holds(motion)
    assert not epochs.stopped_since(motion)
    epochs.check(resume, "resume")
    after = epochs.token("a move")
    epochs.check_leaving(after, "a move")
    assert epochs.token("a move") is after


def test_no_stop_voids_torque_off_and_it_is_done_again_after_one_that_met_it() -> None:
    epochs, done = Epochs(), list[int]()

    def switch_off() -> int:
        token = epochs.token("torque off", freeing=True)
        if len(done) < 2:
            with epochs.stopping():
                pass
        if not done:
            epochs.resumed(epochs.mark())
        epochs.check_leaving(token, "torque off")
        assert epochs.holds(token)
        done.append(len(done))
        if len(done) == 2:
            raise PreemptedError("the stop took the line")
        return done[-1]

    assert epochs.free(switch_off) == 2
    assert done == [0, 1, 2]
    # As a part of a stop it waits for nothing.
    with epochs.stopping():
        assert epochs.free(lambda: 7) == 7


def test_torque_off_that_is_always_refused_raises_that() -> None:
    epochs, tries = Epochs(), list[int]()

    def refused() -> None:
        tries.append(1)
        raise StoppedError("torque off", 5, "it is")

    with pytest.raises(StoppedError):
        epochs.free(refused)
    assert len(tries) < 20

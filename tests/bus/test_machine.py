from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.bus.conversations import Play, make_machine

from hexwire.bus.machine import ADAPTER_TIME, LATEST, BusMachine, Heard, Interrupted, Listen, Send
from hexwire.session.servo_answers import AnswerCollector
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import make_ping, make_read, make_status, make_sync_read, make_sync_write, make_write

READ = make_read(1, 56, 2)
ANSWER = make_status(1, 0, b"\x34\x12")
BASE = 0.001


def collect(machine: BusMachine, play: Play) -> AnswerCollector:
    return play(machine.collect(READ, (1,), 2, BASE, header=None))


def test_an_answer_is_taken_and_its_time_is_learned() -> None:
    machine = make_machine()
    play = Play(machine, lambda _: [(0.002, ANSWER)])
    assert collect(machine, play).answers[1].params == b"\x34\x12"
    assert play.sent == [READ]
    assert machine.now == pytest.approx(100.002)
    assert machine.timing.answers == 1
    assert machine.timing.overhead == pytest.approx(0.002 - 16 * 10e-6)
    assert (machine.counters.requests, machine.counters.answers, machine.counters.lost) == (1, 1, 0)
    assert machine.echo is False
    assert not machine.doubtful


def test_the_wait_is_line_time_and_allowance_and_what_the_line_has_to_carry_first() -> None:
    machine = make_machine()
    play = Play(machine, lambda _: [])
    assert collect(machine, play).missing == (1,)
    assert play.steps == [Send(READ, BASE + machine.timing.allowance)]
    assert machine.now == pytest.approx(100.0 + BASE + machine.timing.allowance)
    packet = make_sync_write(42, {1: b"\0\0", 2: b"\0\0"})
    machine.posted(packet, machine.now)
    machine.posted(packet, machine.now)
    assert machine.backlog(machine.now) == pytest.approx(2 * len(packet) * 10e-6)
    machine.late_replies.clear()
    collect(machine, play)
    step = play.steps[-1]
    assert isinstance(step, Send)
    assert step.window == pytest.approx(BASE + machine.timing.allowance + 2 * len(packet) * 10e-6)
    assert machine.backlog(machine.now) == 0.0


def test_a_lost_answer_leaves_a_doubt_that_ends() -> None:
    machine = make_machine()
    play = Play(machine, lambda _: [])
    collect(machine, play)
    assert machine.counters.lost == 1
    assert play(machine.doubted(1, 2))
    assert not play(machine.doubted(1, 2, READ))
    assert not play(machine.doubted(1, 3))
    assert not play(machine.any_doubted((2, 3), 2))
    assert play(machine.any_doubted((2, 1), 2))
    machine.now += LATEST
    play.steps.clear()
    assert not play(machine.doubted(1, 2))
    # Nobody read meanwhile: the adapter may hold what the doubt was about.
    assert play.steps == [Listen(pytest.approx(machine.now))]
    assert not machine.doubtful


def test_an_echo_is_no_answer_and_is_remembered() -> None:
    machine = make_machine()
    assert collect(machine, Play(machine, lambda packet: [(0.0, packet), (0.001, ANSWER)])).answers
    assert machine.echo is True
    assert machine.counters.echoes == 1
    assert collect(machine, Play(machine, lambda packet: [(0.0, packet)])).missing == (1,)
    assert machine.timing.answers == 1


@pytest.mark.parametrize("earlier", [make_read(1, 42, 2), make_write(1, 42, b"\x05"), make_ping(1)])
def test_the_echo_of_an_earlier_packet_is_no_answer(earlier: bytes) -> None:
    machine = make_machine()
    machine.posted(earlier, machine.now - 0.5)
    play = Play(machine, lambda _: [(0.0, earlier)])
    found = play(machine.collect(READ, (1,), len(earlier) - 6, BASE, header=None))
    assert not found.answers
    assert found.copies == {1}


def test_an_answer_that_comes_late_widens_the_wait() -> None:
    machine = make_machine()
    late = make_machine().timing.allowance + BASE + 0.015
    play = Play(machine, lambda _: [(late, ANSWER)])
    for _ in range(20):
        machine.timing.measured(0.001, 16)
    narrow = machine.timing.allowance
    collect(machine, play)
    machine.now = 100.0 + late
    other = make_read(1, 56, 3)
    play.answering = lambda _: [(0.001, make_status(1, 0, b"abc"))]
    assert play(machine.collect(other, (1,), 3, BASE, header=None)).answers[1].params == b"abc"
    assert machine.timing.allowance > narrow


@given(st.lists(st.integers(0, 24), max_size=6), st.booleans())
def test_bytes_may_come_in_any_pieces(cuts: list[int], echo: bool) -> None:
    ids, request = (1, 2, 3), make_sync_read(56, 2, (1, 2, 3))
    data = (request if echo else b"") + b"".join(make_status(i, 0, bytes((i, 0))) for i in ids)
    edges = [0, *sorted(cuts), len(data)]
    pieces = [data[a:b] for a, b in pairwise(edges) if a < b]
    machine = make_machine()
    play = Play(machine, lambda _: [(0.0002 * k, piece) for k, piece in enumerate(pieces)])
    found = play(machine.collect(request, ids, 2, BASE, header=None))
    assert {i: status.params for i, status in found.answers.items()} == {i: bytes((i, 0)) for i in ids}
    assert machine.counters.stray_bytes == 0


def test_no_flipped_bit_makes_another_answer() -> None:
    for bit in range(8 * len(ANSWER)):
        data = bytearray(ANSWER)
        data[bit // 8] ^= 1 << bit % 8
        machine = make_machine()
        found = collect(machine, Play(machine, lambda _, data=bytes(data): [(0.001, data)]))
        assert not found.answers, f"bit {bit}"
        assert machine.doubtful


@given(st.binary(max_size=40), st.binary(max_size=40))
def test_noise_around_an_answer_gives_it_or_nothing(before: bytes, behind: bytes) -> None:
    machine = make_machine()
    found = collect(machine, Play(machine, lambda _: [(0.001, before + ANSWER + behind)]))
    told = {status.params for status in found.answers.values()}
    forged = any(make_status(1, 0)[:3] in noise for noise in (before, behind))
    assert told <= {b"\x34\x12"} or forged


def test_an_interrupted_wait_leaves_a_doubt_from_that_moment() -> None:
    machine = make_machine()
    conversation = machine.collect(READ, (1,), 2, BASE, header=None)
    assert isinstance(next(conversation), Send)
    with pytest.raises(Interrupted):
        conversation.throw(Interrupted(105.0))
    assert machine.late_replies.holds(1, 2, 105.0 + LATEST - 0.001)
    assert not machine.late_replies.holds(1, 2, 105.0 + LATEST)


def test_an_unsent_request_leaves_no_doubt() -> None:
    machine = make_machine()
    conversation = machine.collect(READ, (1,), 2, BASE, header=None)
    next(conversation)
    conversation.close()
    assert not machine.doubtful
    conversation = machine.collect(READ, (1,), 2, BASE, header=None)
    next(conversation)
    conversation.send(Heard(ANSWER[:3], 100.0))
    conversation.close()
    assert machine.doubtful


def test_the_careful_path_continues_with_the_bytes_of_the_fast_path() -> None:
    machine = make_machine()
    machine.turns += 1
    machine.asked_at = 99.9
    play = Play(machine, lambda _: [(0.0, ANSWER[4:])])
    play._coming.append((100.001, ANSWER[4:]))
    found = play(machine.collect(READ, (1,), 2, BASE, ANSWER[:4], header=None))
    assert found.answers[1].params == b"\x34\x12"
    assert play.sent == []
    assert machine.asked_at is None
    assert (machine.counters.requests, machine.counters.answers) == (1, 1)
    assert machine.timing.overhead == pytest.approx(0.101 - 16 * 10e-6)


def test_a_line_that_never_stops_talking_is_left() -> None:
    machine = make_machine()
    play = Play(machine, lambda _: [(0.0, b"\0" * 64)] * 1000)
    assert not collect(machine, play).answers
    assert len(play.steps) < 100


def test_draining_takes_what_comes_in_a_pause() -> None:
    machine = make_machine()
    play = Play(machine, lambda _: [])
    play._coming = [(100.005, b"abc"), (100.5, b"later")]
    play(machine.drain(ADAPTER_TIME))
    assert machine.counters.stray_bytes == 3
    assert machine.now == pytest.approx(100.0 + ADAPTER_TIME)


def test_another_rate_is_learned_anew_and_nothing_is_outstanding() -> None:
    machine = make_machine()
    machine.gave_up((1, 2), 2, READ, 99.0, 100.0)
    machine.mark_silent(3, 100.0)
    machine.learning = False
    machine.plan_read(1, "present_position")
    machine.restart(1_000_000)
    assert not machine.doubtful
    assert not machine.silent
    assert not machine.plans.reads
    assert not machine.learning
    machine.restart(115_200)
    assert machine.learning
    assert machine.timing.baud == 115_200


def test_every_transaction_is_timed_at_the_beginning() -> None:
    machine = make_machine()
    plan, _ = machine.plan_read(1, "present_position")
    for _ in range(63):
        machine.asked_at = 100.0
        machine.learn_time(plan, 100.001)
        assert machine.asked_at is None
        assert machine.learning
    machine.asked_at = 100.0
    machine.learn_time(plan, 100.001)
    assert not machine.learning
    assert machine.timing.overhead == pytest.approx(0.001 - 16 * 10e-6)


def test_a_transaction_that_is_not_timed_teaches_nothing() -> None:
    machine = make_machine()
    plan, _ = machine.plan_read(1, "present_position")
    machine.learn_time(plan, 100.0)
    assert machine.timing.answers == 0
    # A line that is quicker than its rate says: what was before it is not counted, nor is less than nothing.
    machine.asked_at = 100.3
    machine.learn_time(plan, 100.1)
    assert machine.timing.overhead == 0.0


def test_the_echo_of_a_legacy_servos_read_is_known_before_it_is_sent() -> None:
    machine = make_machine(Series.SEVEN_BOT)
    plan, _ = machine.plan_read(1, "present_position")
    assert plan.request in machine.sent.packets(machine.now)


def test_what_happened_is_counted() -> None:
    machine = make_machine()
    play = Play(machine, lambda _: [(0.001, ANSWER + b"xy")])
    for k in range(1, 4):
        machine.late_replies.clear()
        collect(machine, play)
        counters = machine.counters
        assert (counters.requests, counters.careful) == (k, k)
    machine = make_machine()
    play = Play(machine, lambda packet: [(0.0, packet), (0.001, ANSWER)])
    for k in range(1, 4):
        collect(machine, play)
        counters = machine.counters
        assert (counters.echoes, counters.answers, counters.stray_bytes, counters.lost) == (k, k, 0, 0)
    machine.turns, machine.extra_answers = 10, 6
    assert machine.counters.requests == 13
    assert machine.counters.answers == 19


def test_lost_answers_and_stray_bytes_add_up() -> None:
    machine = make_machine()
    play = Play(machine, lambda _: [(0.001, b"noise")])
    for k in range(1, 4):
        collect(machine, play)
        assert (machine.counters.lost, machine.counters.stray_bytes) == (k, 5 * k)
    machine = make_machine()
    play = Play(machine, lambda _: [])
    for k in range(1, 4):
        play._coming = [(machine.now, b"abc")]
        play(machine.drain())
        assert machine.counters.stray_bytes == 3 * k


def test_a_packet_to_all_has_no_echo_to_remember() -> None:
    machine = make_machine()
    machine.posted(make_sync_write(42, {1: b"\0\0"}), 100.0)
    assert machine.sent.packets(100.0) == set()
    machine.posted(make_write(1, 41, b"\x01"), 100.0)
    assert machine.sent.packets(100.0) == {make_write(1, 41, b"\x01")}


def test_a_line_that_is_free_again_has_no_backlog() -> None:
    machine, packet = make_machine(), make_sync_write(42, {1: b"\0\0"})
    takes = len(packet) * 10e-6
    machine.posted(packet, 100.0)
    assert machine.backlog(100.0 + takes / 2) == pytest.approx(takes / 2)
    assert machine.backlog(100.0 + 2 * takes) == 0.0
    assert machine.busy_until == 0.0
    # What is sent later is not added to what was carried long ago.
    machine.posted(packet, 200.0)
    machine.posted(packet, 300.0)
    assert machine.backlog(300.0) == pytest.approx(takes)


def test_a_silent_servo_rests_for_half_a_second() -> None:
    machine = make_machine()
    machine.mark_silent(3, 100.0)
    assert machine.silent == {3: 100.5}


def test_a_line_is_emptied_with_a_pause_only_after_a_rest() -> None:
    for idle, pause in ((0.05, 0.0), (0.2, ADAPTER_TIME)):
        machine = make_machine()
        play = Play(machine, lambda _: [])
        machine.gave_up((1,), 2, READ, 99.0, 99.1)
        machine.now = 100.1 - idle
        play(machine.doubted(1, 2))
        machine.now = 100.1
        assert not play(machine.doubted(1, 2))
        assert play.steps == [Listen(pytest.approx(100.1 + pause))]
        assert not machine.late_replies.ended


def test_what_was_asked_is_late_from_when_it_was_sent() -> None:
    machine = make_machine()
    play = Play(machine, lambda _: [])
    collect(machine, play)
    assert machine.late_replies.late(1, 2) == 100.0
    assert machine.late_replies.holds(1, 2, machine.now + LATEST - 0.001)


def test_after_the_last_answer_a_line_is_looked_at_a_few_times_only() -> None:
    machine = make_machine()
    play = Play(machine, lambda _: [(0.0, ANSWER)] + [(0.0, READ)] * 100)
    collect(machine, play)
    assert len(play.steps) == 5
    machine = make_machine()
    play = Play(machine, lambda _: [(0.001, ANSWER)])
    collect(machine, play)
    assert len(play.steps) == 2


def test_answers_are_waited_for_by_how_many_are_due() -> None:
    machine, ids = make_machine(), (1, 2, 3)
    request = make_sync_read(56, 2, ids)
    play = Play(machine, lambda _: [(0.001, make_status(1, 0, b"ab"))])
    play(machine.collect(request, ids, 2, 0.003, header=None))
    assert play.steps[1] == Listen(pytest.approx(100.001 + 0.002 + machine.timing.allowance))

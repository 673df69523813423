from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.bus.conversations import Play, make_machine

from hexwire.bus import questions
from hexwire.bus.machine import AFTERMATH, LATEST, BusMachine
from hexwire.errors import UsageError
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import make_legacy_ping_status, make_ping, make_read, make_status

MEMORY = bytes(range(100, 356 - 156)) + bytes(156)


class Servos:
    """What some servos say: their memory, 256 bytes alike."""

    def __init__(self, *ids: int, legacy: bool = False) -> None:
        self.ids = ids
        self.legacy = legacy
        self.asked: list[tuple[int, ...]] = []

    def __call__(self, packet: bytes) -> list[tuple[float, bytes]]:
        servo_id, instruction, params = packet[2], packet[4], packet[5:-1]
        if instruction == 0x82:
            first, count, *asked = params
        else:
            first, count, asked = *(params[:2] or (0, 0)), [servo_id]
        self.asked.append((*asked, first, count))
        answers = []
        for one in asked:
            if one in self.ids:
                if instruction == 1:
                    data = make_legacy_ping_status(one) if self.legacy else make_status(one)
                else:
                    data = make_status(one, 0, MEMORY[first : first + count], legacy=self.legacy)
                answers.append((0.0005, data))
        return answers


def doubt(machine: BusMachine, servo_id: int, params: int) -> None:
    machine.gave_up((servo_id,), params, b"something else", machine.now, machine.now)


def test_a_register_in_doubt_is_read_with_its_neighbours() -> None:
    machine, servos = make_machine(), Servos(1)
    doubt(machine, 1, 2)
    doubt(machine, 1, 3)
    found, _ = Play(machine, servos)(questions.ask_block(machine, 1, 56, 2))
    assert found is not None
    assert found.params == MEMORY[56:58]
    assert servos.asked == [(1, 56, 4)]
    assert machine.counters.settled == 1


# Later than AFTERMATH after an answer to something else, a line would have to change the order of its bytes.
@given(st.floats(0.0, AFTERMATH - 0.02), st.integers(1, 7))
def test_an_answer_that_comes_late_is_no_answer_to_a_later_question(after: float, cut: int) -> None:
    machine, servos = make_machine(), Servos(1)
    late = make_status(1, 0, b"\xaa\x55")
    play = Play(machine, lambda _: [])
    assert play(questions.ask_block(machine, 1, 70, 2))[0] is None
    begin = machine.now
    play._coming = [(begin + after, late[:cut]), (begin + after + 0.0001, late[cut:])]
    play.answering = servos
    while machine.now < begin + LATEST:
        found, _ = play(questions.ask_block(machine, 1, 56, 2))
        assert found is None or found.params == MEMORY[56:58]
        machine.now += 0.01
    found, _ = play(questions.ask_block(machine, 1, 56, 2))
    assert found is not None
    assert found.params == MEMORY[56:58]
    assert servos.asked[-1] == (1, 56, 2)


@pytest.mark.parametrize("retries", [0, 2])
def test_a_servo_that_is_silent_is_asked_so_often_and_then_left_alone(retries: int) -> None:
    machine, servos = make_machine(retries=retries), Servos()
    found, collector = Play(machine, servos)(questions.ask_block(machine, 1, 56, 2))
    assert found is None
    assert collector.missing == (1,)
    assert len(servos.asked) == 1 + retries
    assert machine.counters.repeats == retries
    assert machine.counters.given_up == 1
    assert machine.silent[1] > machine.now


def test_only_the_missing_are_asked_again_and_one_alone_by_a_plain_read() -> None:
    machine, servos = make_machine(retries=1), Servos(1, 2, 3)
    plan = machine.plans.block(56, 2, (1, 2, 3))
    first = [True]

    def answering(packet: bytes) -> list[tuple[float, bytes]]:
        answers = servos(packet)
        return answers[:2] if first and first.pop() else answers

    found = Play(machine, answering)(questions.ask_many(machine, plan, None))
    assert {i: status.params for i, status in found.items()} == dict.fromkeys((1, 2, 3), MEMORY[56:58])
    # The answer that did not come may still come: in that length none is believed.
    assert servos.asked == [(1, 2, 3, 56, 2), (3, 56, 3)]


def test_silent_servos_go_first_in_a_sync_read() -> None:
    machine, servos = make_machine(), Servos(1, 2)
    plan = machine.plans.block(56, 2, (1, 2, 3))
    machine.mark_silent(3, machine.now)
    found = Play(machine, servos)(questions.ask_many(machine, plan, None))
    assert set(found) == {1, 2}
    assert servos.asked == [(3, 1, 2, 56, 2)]


def test_a_ping_in_doubt_waits_for_another_answer() -> None:
    machine, servos = make_machine(), Servos(1)
    doubt(machine, 1, 0)
    play = Play(machine, servos)
    request = make_ping(1)
    asking = questions.ask_one(machine, 1, request, 0, base=0.001, header=None, retries=0)
    assert play(asking)[0] is not None
    assert servos.asked[0][2] == 1, "one byte of any register first"
    assert play.sent[1] == request
    servos.ids = ()
    doubt(machine, 1, 0)
    asking = questions.ask_one(machine, 1, request, 0, base=0.001, header=None, retries=0)
    assert play(asking)[0] is None
    assert play.sent[-1] != request, "it is not even sent where nothing else is answered"


def test_a_legacy_servo_in_doubt_is_asked_in_its_other_length_twice() -> None:
    machine, servos = make_machine(Series.SEVEN_BOT), Servos(1, legacy=True)
    doubt(machine, 1, 2)
    play = Play(machine, servos)
    found, _ = play(questions.ask_block(machine, 1, 56, 2))
    assert found is not None
    assert found.params == MEMORY[56:58]
    assert play.sent == [make_ping(1), make_ping(1), make_read(1, 56, 2)]


def test_a_legacy_servo_with_both_lengths_in_doubt_is_not_believed() -> None:
    machine, servos = make_machine(Series.SEVEN_BOT), Servos(1, legacy=True)
    doubt(machine, 1, 2)
    doubt(machine, 1, 0)
    play = Play(machine, servos)
    assert play(questions.ask_block(machine, 1, 56, 2))[0] is None
    assert play.sent == []


def test_many_registers_of_a_legacy_servo_are_read_in_pairs() -> None:
    machine, servos = make_machine(Series.SEVEN_BOT), Servos(1, legacy=True)
    assert Play(machine, servos)(questions.ask_registers(machine, 1, 56, 5)) == (MEMORY[56:61], 0)
    assert servos.asked == [(1, 56, 2), (1, 58, 2), (1, 60, 2)]
    assert Play(machine, Servos())(questions.ask_registers(machine, 1, 56, 5)) == (b"", 0)


def test_registers_that_cannot_be_are_refused() -> None:
    machine = make_machine()
    with pytest.raises(UsageError):
        Play(machine, Servos(1))(questions.ask_registers(machine, 1, 300, 2))


def test_whether_a_servo_is_there_is_asked_in_one_byte() -> None:
    machine, servos = make_machine(), Servos(1)
    found, _ = Play(machine, servos)(questions.is_there(machine, 1))
    assert found is not None
    assert servos.asked[0][2] == 1
    assert machine.counters.settled == 1
    Play(machine, servos)(questions.is_there(machine, 1))
    assert machine.counters.settled == 2


def test_a_request_of_one_length_is_repeated_and_then_given_up() -> None:
    for retries in (0, 2):
        machine, request = make_machine(retries=0), make_ping(1)
        play = Play(machine, Servos())
        asking = questions.ask_one(machine, 1, request, 0, base=0.001, header=None, retries=retries)
        assert play(asking)[0] is None
        assert play.sent == [request] * (1 + retries)
        counters = machine.counters
        assert (counters.repeats, counters.given_up, counters.lost) == (retries, 1, 1 + retries)
        assert machine.silent[1] > machine.now
        # An answer takes it back.
        machine.late_replies.clear()
        play.answering = Servos(1)
        asking = questions.ask_one(machine, 1, request, 0, base=0.001, header=None, retries=retries)
        found, _ = play(asking)
        assert found is not None
        assert not machine.silent
        assert machine.counters.given_up == 1


def test_a_servo_whose_answer_may_be_an_echo_is_neither_silent_nor_asked_the_same_again() -> None:
    machine, request = make_machine(), make_ping(1)
    play = Play(machine, lambda packet: [(0.001, packet)])
    found, collector = play(questions.ask_one(machine, 1, request, 0, base=0.001, header=None, retries=3))
    assert found is None
    assert collector.copies == {1}
    assert play.sent == [request]
    assert not machine.silent
    assert machine.counters.given_up == 1


def test_a_block_whose_answer_may_be_an_echo_is_asked_otherwise_even_without_repeats() -> None:
    machine, servos = make_machine(), Servos(1)

    def answering(packet: bytes) -> list[tuple[float, bytes]]:
        return [(0.001, packet)] if packet == make_read(1, 56, 2) else servos(packet)

    play = Play(machine, answering)
    found, _ = play(questions.ask_block(machine, 1, 56, 2))
    assert found is not None
    assert found.params == MEMORY[56:58]
    assert play.sent == [make_read(1, 56, 2), make_read(1, 56, 3)]
    assert (machine.counters.repeats, machine.counters.settled, machine.counters.given_up) == (1, 1, 0)


def test_it_continues_with_bytes_that_have_already_arrived() -> None:
    machine, servos = make_machine(retries=1), Servos(1)
    play = Play(machine, servos)
    answer = make_status(1, 0, MEMORY[56:58])
    found, _ = play(questions.ask_block(machine, 1, 56, 2, base=0.001, data=answer))
    assert found is not None
    assert play.sent == []
    found, _ = play(questions.ask_block(machine, 1, 56, 2, base=0.001, data=answer[:-1] + b"\0"))
    assert found is not None
    assert play.sent == [make_read(1, 56, 3)]
    assert machine.counters.repeats == 1


def test_each_servo_is_asked_as_its_own_series_wants() -> None:
    machine = make_machine(Series.STS_SMS)
    machine.servos.set_series(7, Series.SEVEN_BOT)
    servos = Servos(7, legacy=True)
    doubt(machine, 7, 2)
    play = Play(machine, servos)
    found, _ = play(questions.ask_block(machine, 7, 56, 2))
    assert found is not None
    assert play.sent == [make_ping(7), make_ping(7), make_read(7, 56, 2)]
    assert Play(machine, servos)(questions.ask_registers(machine, 7, 56, 4)) == (MEMORY[56:60], 0)
    assert servos.asked[-2:] == [(7, 56, 2), (7, 58, 2)]
    # An answer in the other kind's header is none.
    servos.legacy = False
    machine.late_replies.clear()
    assert Play(machine, servos)(questions.ask_block(machine, 7, 56, 2))[0] is None


def test_error_bits_of_all_parts_are_reported() -> None:
    machine = make_machine(Series.SEVEN_BOT)
    errors = iter((1, 32, 0))
    play = Play(machine, lambda packet: [(0.001, make_status(1, next(errors), b"ab", legacy=True))])
    assert play(questions.ask_registers(machine, 1, 56, 6)) == (b"ababab", 33)


def test_settling_needs_an_answer_and_marks_servos_without_one() -> None:
    machine, servos = make_machine(), Servos(1)
    for servo_id, there in ((1, True), (2, False)):
        doubt(machine, servo_id, 0)
        doubt(machine, servo_id, 5)
        assert Play(machine, servos)(questions.settle(machine, servo_id, 0)) is there
        assert machine.late_replies.holds(servo_id, 0, machine.now) is not there
        assert machine.late_replies.holds(servo_id, 5, machine.now), "only the length that was asked about"
        assert (servo_id in machine.silent) is not there


def test_a_legacy_servo_is_believed_only_if_it_answers_twice() -> None:
    for answers, settled in (((True, True), True), ((True, False), False), ((False,), False)):
        machine, servos = make_machine(Series.SEVEN_BOT), Servos(1, legacy=True)
        doubt(machine, 1, 2)
        left = list(answers)

        def answering(packet: bytes, servos: Servos = servos, left: list[bool] = left) -> list[tuple[float, bytes]]:
            return servos(packet) if left and left.pop(0) else []

        play = Play(machine, answering)
        assert play(questions.settle(machine, 1, 2)) is settled
        assert play.sent == [make_ping(1)] * len(answers)
        assert machine.counters.settled == settled
    machine, servos = make_machine(Series.SEVEN_BOT), Servos(1, legacy=True)
    doubt(machine, 1, 0)
    play = Play(machine, servos)
    assert play(questions.settle(machine, 1, 0))
    assert play.sent == [make_read(1, 63, 2)] * 2


def test_a_legacy_servo_in_doubt_is_not_settled_by_an_answer_of_the_other_kind() -> None:
    machine, servos = make_machine(Series.SEVEN_BOT), Servos(1)
    doubt(machine, 1, 2)
    assert not Play(machine, servos)(questions.settle(machine, 1, 2))
    assert machine.late_replies.holds(1, 2, machine.now)


def test_a_servo_silent_in_a_sync_read_is_not_asked_again_for_half_a_second() -> None:
    machine, servos = make_machine(retries=1), Servos(1, 2)
    plan = machine.plans.block(56, 2, (1, 2, 3))
    play = Play(machine, servos)
    assert set(play(questions.ask_many(machine, plan, None))) == {1, 2}
    assert [row[:-2] for row in servos.asked] == [(1, 2, 3), (3,)]
    assert machine.counters.given_up == 1
    until = machine.silent[3]
    machine.late_replies.clear()
    servos.asked.clear()
    assert set(play(questions.ask_many(machine, plan, None))) == {1, 2}
    assert [row[:-2] for row in servos.asked] == [(3, 1, 2)]
    assert machine.silent[3] == until, "the rest is not prolonged"
    machine.now = until
    servos.ids, servos.asked = (1, 2, 3), []
    machine.late_replies.clear()
    assert set(play(questions.ask_many(machine, plan, None))) == {1, 2, 3}
    assert not machine.silent
    assert machine.counters.given_up == 2


def test_a_sync_read_is_asked_where_most_servos_have_no_doubt() -> None:
    machine, servos = make_machine(retries=1), Servos(1, 2, 3)
    plan = machine.plans.block(56, 2, (1, 2, 3))
    # 1 has doubts in every length, which no block can go round.
    for count in range(1, 247):
        doubt(machine, 1, count)
    doubt(machine, 2, 2)
    found = Play(machine, servos)(questions.ask_many(machine, plan, None))
    assert {i: status.params for i, status in found.items()} == dict.fromkeys((2, 3), MEMORY[56:58])
    assert servos.asked[0] == (2, 3, 56, 3)
    assert machine.counters.settled == 2
    assert machine.counters.given_up == 1


def test_a_sync_read_with_an_answer_that_may_be_an_echo_is_asked_otherwise_even_without_repeats() -> None:
    machine, servos = make_machine(), Servos(1, 2)
    plan = machine.plans.block(56, 2, (1, 2))
    copy = make_read(2, 56, 2)

    def answering(packet: bytes) -> list[tuple[float, bytes]]:
        answers = servos(packet)
        return [answers[0], (0.0006, copy)] if packet == plan.request else answers

    play = Play(machine, answering)
    found = play(questions.ask_many(machine, plan, None))
    assert {i: status.params for i, status in found.items()} == dict.fromkeys((1, 2), MEMORY[56:58])
    assert play.sent == [plan.request, make_read(2, 56, 3)]
    assert machine.counters.repeats == 1

from __future__ import annotations

from hexwire.bus.machine import AFTERMATH, LATEST, LateReplies, SentLately
from hexwire.wire.servo_packet import make_ping, make_read, make_write

READ = make_read(1, 56, 2)


def test_an_unanswered_request_is_in_doubt_by_servo_and_length_until_its_time_is_over() -> None:
    late = LateReplies()
    assert not late.servos
    late.add(1, 2, READ, 9.9, 10.0)
    assert late.servos
    assert late.holds(1, 2, 10.0)
    assert not late.holds(1, 3, 10.0)
    assert not late.holds(2, 2, 10.0)
    assert late.holds(1, 2, 10.0 + LATEST - 0.001)
    assert not late.ended
    assert not late.holds(1, 2, 10.0 + LATEST)
    assert late.ended
    assert not late.servos


def test_the_same_request_again_is_not_in_doubt_of_itself() -> None:
    late = LateReplies()
    late.add(1, 2, READ, 10.0, 10.0)
    assert not late.holds(1, 2, 10.0, READ)
    late.add(1, 2, make_read(1, 42, 2), 10.1, 10.1)
    assert late.holds(1, 2, 10.2, READ)


def test_an_answer_in_another_length_shortens_the_doubt_but_one_in_the_same_does_not() -> None:
    late = LateReplies()
    late.add(1, 2, READ, 10.0, 10.0)
    late.answered(1, 2, 10.1)
    assert late.holds(1, 2, 10.1 + AFTERMATH)
    late.answered(1, 3, 10.1)
    assert late.holds(1, 2, 10.1 + AFTERMATH - 0.001)
    assert not late.holds(1, 2, 10.1 + AFTERMATH)


def test_a_settled_length_leaves_the_others() -> None:
    late = LateReplies()
    late.add(1, 2, READ, 10.0, 10.0)
    late.add(1, 0, make_ping(1), 10.0, 10.0)
    late.settled(1, 0)
    assert not late.holds(1, 0, 10.0)
    assert late.holds(1, 2, 10.0)
    late.settled(1, 2)
    assert not late.servos
    late.settled(7, 0)


def test_a_late_answer_tells_when_it_was_asked_for() -> None:
    late = LateReplies()
    late.add(1, 2, READ, 9.5, 10.0)
    assert late.late(1, 2) == 9.5
    assert late.late(1, 3) is None
    late.clear()
    assert late.late(1, 2) is None


def test_recent_requests_are_remembered_and_memory_is_bounded() -> None:
    sent = SentLately()
    for k in range(2000):
        sent.add(make_write(1, 42, k.to_bytes(2, "little")), 10.0 + 0.01 * k)
    now = 10.0 + 0.01 * 1999
    assert sent.packets(now) == {
        make_write(1, 42, k.to_bytes(2, "little")) for k in range(2000) if 10.0 + 0.01 * k > now - LATEST
    }
    assert len(sent._when) <= 257


def test_the_last_packets_are_known_however_long_the_host_stood_still() -> None:
    sent = SentLately()
    for k in range(200):
        sent.add(make_write(1, 42, k.to_bytes(2, "little")), 10.0)
    sent.add(make_write(1, 42, b"\0\0"), 10.0)
    late = sent.packets(1000.0)
    assert len(late) == 64
    assert {make_write(1, 42, b"\0\0"), make_write(1, 42, bytes((199, 0)))} <= late


def test_an_answer_never_lengthens_a_doubt() -> None:
    late = LateReplies()
    late.add(1, 2, READ, 10.0, 10.0)
    late.answered(1, 3, 10.0 + LATEST - 0.01)
    assert not late.holds(1, 2, 10.0 + LATEST)
    late.answered(2, 3, 10.0)


def test_a_doubt_given_up_twice_lasts_from_the_second_time() -> None:
    late = LateReplies()
    late.add(1, 2, READ, 9.0, 10.0)
    late.add(1, 2, READ, 9.5, 10.5)
    assert late.late(1, 2) == 9.5
    assert late.holds(1, 2, 10.5 + LATEST - 0.01)
    assert not late.holds(1, 2, 10.6, READ), "the same request is in doubt with others only"
    late.add(1, 3, READ, 10.0, 11.0)
    assert not late.holds(1, 2, 10.5 + LATEST)
    assert late.holds(1, 3, 10.5 + LATEST)
    assert late.ended


def test_of_many_packets_the_recent_and_the_last_are_kept() -> None:
    sent = SentLately()
    packets = [make_write(1, 42, k.to_bytes(2, "little")) for k in range(100)]
    for k, packet in enumerate(packets):
        sent.add(packet, 10.0 + (k >= 20))
    # 64 are the last; of the others those of the last second.
    assert sent.packets(11.5) == set(packets[20:])
    assert sent.packets(11.0) == set(packets[20:])
    assert sent.packets(12.0) == set(packets[36:])
    assert sent.packets(10.9) == set(packets)
    few = SentLately()
    for packet in packets[:64]:
        few.add(packet, 10.0)
    few.prepare(packets[70])
    assert few.packets(1000.0) == {*packets[:64], packets[70]}
    # Sent again, it is the last.
    few.add(packets[0], 11.0)
    few.add(packets[80], 11.0)
    assert few.packets(1000.0) == {packets[0], *packets[2:64], packets[70], packets[80]}

"""What the board remembers of its answers."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.frames import frame_bytes

from hexwire.session.connection import ReplyStore
from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Frame, parse_frame


def frame(seq: int, *, src: int = 7, cmd: int = 0x13, body: bytes = b"b", sn: int = 0) -> Frame:
    return parse_frame(frame_bytes(cmd, body, seq=seq, sn=sn, src=src, time_sec=sn))


def test_a_repeat_is_same_src_seq_cmd_and_body_whatever_its_clock() -> None:
    store = ReplyStore()
    store.answered(frame(1), [b"answer"], 0.0)
    assert store.find(frame(1, sn=99), 1.0) == [b"answer"]
    for other in (frame(2), frame(1, src=0), frame(1, cmd=0x14), frame(1, body=b"c")):
        assert store.find(other, 1.0) is None


def test_it_forgets_after_two_seconds_and_after_four_others() -> None:
    store = ReplyStore()
    store.answered(frame(1), [b"1"], 0.0)
    assert store.find(frame(1), tables.REPEAT_WINDOW - 0.001) == [b"1"]
    assert store.find(frame(1), tables.REPEAT_WINDOW) is None
    for seq in range(2, 6):
        store.answered(frame(seq), [b"x"], 0.0)
    assert store.find(frame(1), 0.0) is None
    assert store.find(frame(2), 0.0) == [b"x"]


def test_a_request_in_progress_is_not_begun_again() -> None:
    store = ReplyStore()
    store.asked(frame(1), 0.0)
    assert store.find(frame(1), 0.5) == []
    assert store.find(frame(1), tables.REPEAT_WINDOW) is None
    store.answered(frame(1), [b"done"], 0.6)
    assert store.find(frame(1), 0.7) == [b"done"]


def test_a_module_that_starts_anew_repeats_nothing_and_others_keep_theirs() -> None:
    store = ReplyStore()
    for src in (7, 0):
        store.answered(frame(1, src=src), [b"1"], 0.0)
        store.asked(frame(2, src=src), 0.0)
    store.forget(7)
    assert store.find(frame(1), 0.0) is None
    assert store.find(frame(2), 0.0) is None
    assert store.find(frame(1, src=0), 0.0) == [b"1"]
    assert store.find(frame(2, src=0), 0.0) == []
    # And the bounds still hold afterwards.
    for seq in range(10, 15):
        store.answered(frame(seq), [b"x"], 0.0)
    assert store.find(frame(10), 0.0) is None


def test_by_number() -> None:
    store = ReplyStore()
    store.answered(frame(1), [b"1"], 0.0)
    assert store.find_by_number(7, 1, 0x13, 1.0) == [b"1"]
    assert store.find_by_number(7, 1, 0x13, 2.0) == []
    assert store.find_by_number(8, 1, 0x13, 1.0) == []


def test_voided_requests_are_remembered_however_many_they_are() -> None:
    store = ReplyStore()
    for seq in range(30):
        store.asked(frame(seq), 0.0)
    for seq in range(30):
        assert store.find(frame(seq), 0.1) == [], "every request that waits is known"
        store.answered(frame(seq), [b"void"], 0.1, voided=True)
    for seq in range(100, 110):
        store.answered(frame(seq), [b"x"], 0.2)
    for seq in range(30):
        assert store.find(frame(seq), 2.0) == [b"void"]
        assert store.find(frame(seq), 2.2) is None
    store.forget(7)
    assert store.find(frame(0), 0.2) is None


STEPS = st.lists(
    st.tuples(
        st.sampled_from(("ask", "answer", "answer", "answer void")),
        st.integers(1, 7),
        st.sampled_from((7, 9)),
        st.sampled_from((0.0, 0.25, 1.0, 1.5)),
    ),
    max_size=25,
)


@given(STEPS, st.sampled_from((0.0, 100.0)))
def test_as_plain_lists_of_what_was_answered(steps: list[tuple[str, int, int, float]], start: float) -> None:
    store, now = ReplyStore(), start
    answered: list[tuple[float, Frame, list[bytes]]] = []
    voided: list[tuple[float, Frame, list[bytes]]] = []
    waiting: list[tuple[float, Frame]] = []
    for what, seq, src, pause in steps:
        now += pause
        request = frame(seq, src=src)
        if what == "ask":
            store.asked(request, now)
            waiting.append((now, request))
        else:
            reply = [f"{what} {now}".encode()]
            store.answered(request, reply, now, voided=what == "answer void")
            (voided if what == "answer void" else answered).append((now, request, reply))
            first = next((entry for entry in waiting if entry[1] == request), None)
            if first is not None:
                waiting.remove(first)
        answered = answered[-4:]
        for seq, src in ((seq, src) for seq in range(1, 8) for src in (7, 9)):
            asked = frame(seq, src=src)
            replies = [r for when, f, r in answered + voided if f == asked and now - when < 2.0]
            open_ = any(f == asked and now - when < 2.0 for when, f in waiting)
            assert store.find(asked, now) == (replies[0] if replies else [] if open_ else None)
            assert store.find_by_number(src, seq, asked.cmd, now) == (replies[0] if replies else [])


@pytest.mark.parametrize("pause", [0.5, 1.99])
def test_lasting_requests_are_refused_after_a_stop_within_the_repeat_window(pause: float) -> None:
    store = ReplyStore()
    lasting = (Command.RESUME, Command.TORQUE, Command.MAINTENANCE)
    for seq, cmd in enumerate((*lasting, Command.JOINT_MOVE)):
        store.answered(frame(seq, cmd=cmd), [b"done"], 100.0)
    for seq in range(10, 14):
        store.answered(frame(seq), [b"x"], 100.0)
    store.void(lambda request: b"refused %d" % request.seq, 100.0 + pause)
    for seq, cmd in enumerate(lasting):
        assert store.find(frame(seq, cmd=cmd), 101.99) == [b"refused %d" % seq]
        assert store.find(frame(seq, cmd=cmd), 102.0) is None
    assert store.find(frame(3, cmd=Command.JOINT_MOVE), 101.0) is None
    # A second stop has nothing to add, and what was done longer ago is no repeat any more.
    store.void(lambda _: b"twice", 101.99)
    assert store.find(frame(0, cmd=Command.RESUME), 101.99) == [b"refused 0"]
    store.answered(frame(20, cmd=Command.TORQUE), [b"done"], 103.0)
    for seq in range(30, 34):
        store.answered(frame(seq), [b"x"], 103.0)
    store.void(lambda _: b"late", 105.0)
    assert store.find(frame(20, cmd=Command.TORQUE), 104.9) is None


def test_a_module_that_starts_anew_is_not_refused_for_what_it_did_before_a_stop() -> None:
    store = ReplyStore()
    for src in (7, 9):
        store.answered(frame(1, src=src, cmd=Command.TORQUE), [b"done"], 0.0)
        for seq in range(2, 6):
            store.answered(frame(seq, src=src), [b"x"], 0.0)
    store.forget(7)
    store.void(lambda _: b"refused", 0.5)
    assert store.find(frame(1, cmd=Command.TORQUE), 0.5) is None
    assert store.find(frame(1, src=9, cmd=Command.TORQUE), 0.5) == [b"refused"]

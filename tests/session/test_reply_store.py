"""What the board remembers of its answers."""

from __future__ import annotations

from hexwire.session.reply_store import ReplyStore
from hexwire.wire import tables
from hexwire.wire.command_frame import Frame, parse_frame, serialize_frame


def frame(seq: int, *, src: int = 7, cmd: int = 0x13, body: bytes = b"b", sn: int = 0) -> Frame:
    return parse_frame(
        serialize_frame(
            Frame(proto=2, cmd=cmd, body=body, seq=seq, sn=sn, src=src, dst=8, type=3, time_sec=sn, time_nsec=0)
        )
    )


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


def test_what_a_stop_made_void_is_remembered_however_much_it_was() -> None:
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

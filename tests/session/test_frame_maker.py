from __future__ import annotations

import pytest

from hexwire.errors import LocalProtocolError
from hexwire.session.frame_maker import FrameMaker, Role
from hexwire.wire.command_frame import Command, parse_frame
from hexwire.wire.commands import FragmentHead


def maker(role: Role, **changes: object) -> FrameMaker:
    given: dict[str, object] = {
        "local": 7, "remote": 8, "type": 3, "max_frame": 8192, "epoch": 100.0, "cautious": False, "numbers": None,
    }  # fmt: skip
    return FrameMaker(role, **(given | changes))  # type: ignore[arg-type]  # the values above fit


def test_frames_are_numbered_stamped_and_addressed() -> None:
    host = maker(Role.HOST)
    first, second = (parse_frame(host.build(2, Command.STATS, b"x", 5, 2.5)) for _ in range(2))
    assert (first.sn, second.sn, host.sn) == (1, 2, 2)
    assert (first.time, first.src, first.dst, first.type, first.seq, first.body) == (102.5, 7, 8, 3, 5, b"x")
    assert parse_frame(host.build(2, Command.STATS, b"", 5, 0.0, 0x85, 1)).dst == 1
    assert host.counters.frames_sent == 3


def test_over_datagrams_number_and_type_are_the_conversations() -> None:
    host = maker(Role.HOST, numbers=lambda: 0xFFFFFFF0 >> 1)
    frame = parse_frame(host.build(2, Command.IDENTIFY, b"", 5, 0.0))
    assert (frame.sn, frame.type) == (0x7FFFFFF9, 3)
    assert host.conversations is not None
    assert list(host.conversations._asked) == [0x7FFFFFF9]


def test_a_cautious_frame_keeps_the_end_of_a_frame_out_and_is_known_by_the_number_it_got() -> None:
    host = maker(Role.HOST, cautious=True, numbers=lambda: 0x0A0C)
    data = host.build(2, Command.IDENTIFY, b"", 5, 0.0)
    assert b"\r\n" not in data[4:-2]
    assert host.conversations is not None
    assert list(host.conversations._asked) == [parse_frame(data).sn] == [host.sn]
    host.conversations._sn = 0x0A0C
    data = host.build(2, Command.IDENTIFY, b"", 5, 0.0)
    assert list(host.conversations._asked)[-1] == parse_frame(data).sn


def test_a_stored_frame_goes_out_with_a_new_number_and_time() -> None:
    board = maker(Role.BOARD, local=8, remote=7)
    stored = board.build(2, Command.STATS, b"old", 9, 1.0, 0x80)
    again = parse_frame(board.build_again(stored, 4.0))
    assert (again.sn, again.time, again.seq, again.body, again.cmd_ext) == (2, 104.0, 9, b"old", 0x80)


def test_dialect_1_as_the_chapters_board_makes_it() -> None:
    board = maker(Role.BOARD, local=8, remote=7, type=8)
    data = board.build_dialect1(b"\xff\xf5\xff\x06\x04\xf6", 0.0015, 0)
    frame = parse_frame(data)
    assert (frame.proto, frame.cmd, frame.seq, frame.time_nsec) == (1, 2, 1, 1_000_000)
    assert data[46:48] == b"\xff\xff", "not checked"


def test_what_waits_is_taken_once_and_can_be_taken_back_before() -> None:
    host = maker(Role.HOST)
    first, second = host.send_chapter(Command.READ, b"a", 0.0), host.send_chapter(Command.READ, b"b", 0.0)
    assert not host.withhold(first)
    assert host.data_to_send() == [second]
    assert host.data_to_send() == []
    assert host.withhold(second), "it is on its way"


def test_a_report_has_a_count_of_its_own() -> None:
    board = maker(Role.BOARD, local=8, remote=7)
    for _ in range(2):
        board.report(Command.JOINT_STATE, b"x", 0.0)
    reports = [parse_frame(data) for data in board.data_to_send()]
    assert [(report.seq, report.is_unsolicited) for report in reports] == [(1, True), (2, True)]


def test_no_peer_is_believed_that_takes_next_to_nothing() -> None:
    host = maker(Role.HOST)
    host.limit_frame(1)
    assert host.max_frame == 128
    host.limit_frame(8192)
    assert host.max_frame == 128


def test_every_frame_is_counted_once() -> None:
    host = maker(Role.HOST)
    host.send_chapter(Command.READ, b"a", 0.0)
    host.report(Command.JOINT_STATE, b"", 0.0)
    host.reply_dialect1(b"a", 0.0)
    host._send_message(Command.STATS, 0, bytes(20_000), 5, 0.0)
    assert host.counters.frames_sent == len(host.data_to_send()) == 6


def test_the_number_comes_round_in_every_kind_of_frame() -> None:
    host = maker(Role.HOST)
    for make in (
        lambda: host.build(2, Command.STATS, b"", 5, 0.0),
        lambda: host.build_dialect1(b"a", 0.0, 0),
    ):
        host.sn = 0xFFFFFFFE
        assert [parse_frame(make()).sn for _ in range(3)] == [0xFFFFFFFF, 0, 1]


def test_the_count_of_commands_comes_round() -> None:
    host = maker(Role.HOST)
    host.seq = 0xFE
    host.report(Command.JOINT_STATE, b"", 0.0)
    host.send_chapter(Command.READ, b"a", 0.0)
    host.report(Command.JOINT_STATE, b"", 0.0)
    assert [parse_frame(data).seq for data in host.data_to_send()] == [0xFF, 0, 1]


def test_a_chapter_boards_count_is_the_low_byte_of_its_number() -> None:
    board = maker(Role.BOARD, local=8, remote=7, type=8)
    board.sn = 0x12FE
    frames = [parse_frame(board.build_dialect1(b"a", 1.25, 3)) for _ in range(2)]
    assert [(f.sn, f.seq) for f in frames] == [(0x12FF, 0xFF), (0x1300, 0)]
    assert [(f.src, f.dst, f.type, f.time) for f in frames] == [(8, 3, 8, 101.25)] * 2


def test_a_message_is_known_by_the_seq_of_its_request() -> None:
    host = maker(Role.HOST)
    host._message_count = 0xFE
    ids = [host._send_message(Command.STATS, 0x80, bytes(9000), seq, 0.0, 4) for seq in (5, 6)]
    assert ids == [0xFF05, 0x0006]
    frames = [parse_frame(data) for data in host.data_to_send()]
    heads = [FragmentHead.parse(frame.body) for frame in frames]
    assert {(head.cmd, head.cmd_ext, head.chunks) for head in heads} == {(Command.STATS, 0x80, 2)}
    assert [(head.message_id, head.number) for head in heads] == [(0xFF05, 0), (0xFF05, 1), (6, 0), (6, 1)]
    assert {(frame.dst, frame.cmd) for frame in frames} == {(4, Command.FRAGMENT)}
    assert [frame.size for frame in frames[::2]] == [8192, 8192], "as much as a frame takes"


def test_of_several_frames_some_may_have_gone() -> None:
    host = maker(Role.HOST)
    gone = host.send_chapter(Command.READ, b"a", 0.0)
    host.data_to_send()
    kept, back = (host.send_chapter(Command.READ, b"a", 0.0) for _ in range(2))
    assert host._withhold([gone, back])
    assert host.data_to_send() == [kept]
    one, two = (host.send_chapter(Command.READ, b"a", 0.0) for _ in range(2))
    assert not host._withhold([one, two])
    assert host.data_to_send() == []


def test_no_frame_of_any_kind_is_longer_than_the_line_takes() -> None:
    board = maker(Role.BOARD, max_frame=253)
    for send in (
        lambda body: board.report(Command.JOINT_STATE, body, 0.0),
        lambda body: board.reply_dialect1(body, 0.0),
    ):
        send(bytes(208))
        with pytest.raises(LocalProtocolError, match="needs a frame of 256 bytes, the line takes 253"):
            send(bytes(209))
    assert [len(data) for data in board.data_to_send()] == [252, 252]


@pytest.mark.parametrize("role", Role)
@pytest.mark.parametrize("cautious", [False, True])
def test_who_keeps_the_end_of_a_frame_out(role: Role, cautious: bool) -> None:
    """A host does in dialect 1, since an old board may listen; nobody else unless told to."""
    for proto in (1, 2):
        end = maker(role, cautious=cautious, max_frame=8192)
        end.sn = 0x0A0C
        data = end.build(proto, Command.READ, b"a", 5, 0.0)
        clean = cautious or (role is Role.HOST and proto == 1)
        assert (b"\r\n" in data[4:-2]) is not clean
        assert end.sn == parse_frame(data).sn
        # Nor does it send more than an old board has room for.
        if clean:
            with pytest.raises(LocalProtocolError, match="the line takes 253"):
                end.build(proto, Command.READ, bytes(300), 5, 0.0)
        else:
            assert len(end.build(proto, Command.READ, bytes(300), 5, 0.0)) == 344

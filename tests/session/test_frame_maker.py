from __future__ import annotations

from hexwire.session.frame_maker import FrameMaker, Role
from hexwire.wire.command_frame import Command, parse_frame


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

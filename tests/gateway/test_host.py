"""One host of a gateway, on a stream."""

from __future__ import annotations

from hexwire.gateway.host import Host
from hexwire.wire.command_frame import Command, Frame, parse_frame


def test_frames_wait_for_it_as_they_are_until_it_is_gone() -> None:
    host = Host("one", (8, 9))
    frame = Frame(1, 2, 3, 8, 7, 8, 2, 5, Command.STATS, b"")
    assert host.takes(frame, 1.0)
    host.asker = frame
    host.send([frame, frame])
    assert [parse_frame(data) for data in host.out] == [frame, frame]
    host.forget()
    assert (host.out, host.asker, host.generation) == ([], None, 0)

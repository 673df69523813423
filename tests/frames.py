"""Frames with the usual fields, but for those that a test is about."""

from __future__ import annotations

from typing import Any

from hexwire.wire.command_frame import Frame, serialize_frame

_USUAL = {"proto": 2, "seq": 1, "src": 7, "dst": 8, "type": 3, "time_sec": 1, "time_nsec": 0}


def make_frame(cmd: int, body: bytes = b"", **fields: Any) -> Frame:
    """A frame of dialect 2 from the host to the board of a 7Bot; `sn` is `seq` if it is not given."""
    given = {**_USUAL, **fields}
    given.setdefault("sn", given["seq"])
    return Frame(cmd=cmd, body=body, **{**given, "seq": given["seq"] & 0xFF})


def frame_bytes(cmd: int, body: bytes = b"", **fields: Any) -> bytes:
    """The bytes of `make_frame`."""
    return serialize_frame(make_frame(cmd, body, **fields))

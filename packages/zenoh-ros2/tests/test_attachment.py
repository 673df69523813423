from __future__ import annotations

import pytest
import zenoh.ext
from hypothesis import given
from hypothesis import strategies as st

from zenoh_ros2.attachment import Attachment
from zenoh_ros2.errors import RemoteProtocolError

BIG = st.integers(0, 2**63 - 1)


@given(BIG, BIG, st.binary(min_size=16, max_size=16))
def test_its_bytes_are_those_of_zenohs_serializer(sequence: int, stamp: int, gid: bytes) -> None:
    attachment = Attachment(sequence, stamp, gid)
    ext = zenoh.ext
    expected = ext.z_serialize((ext.Int64(sequence), ext.Int64(stamp), gid)).to_bytes()
    assert attachment.serialize() == expected
    assert Attachment.parse(expected) == attachment


@pytest.mark.parametrize("data", [None, b"", bytes(33), b"\0" * 32, b"\xff" * 33, bytes(16) + b"\x10" + bytes(17)])
def test_other_bytes_are_refused(data: bytes | None) -> None:
    with pytest.raises(RemoteProtocolError):
        Attachment.parse(data)


@given(st.binary(max_size=64))
def test_any_bytes_are_read_or_refused(data: bytes) -> None:
    try:
        Attachment.parse(data)
    except RemoteProtocolError:
        return
    assert len(data) == 33

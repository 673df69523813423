from __future__ import annotations

import io
import struct

from hexwire.link.tap import Direction, Passed
from hexwire.trace.pcap import write_pcapng


def test_pcapng_blocks_are_aligned_and_say_the_direction() -> None:
    file = io.BytesIO()
    traffic = [Passed(Direction.SENT, b"\xff" * 5, 3.25, ""), Passed(Direction.RECEIVED, b"ab", 3.5, "")]
    assert write_pcapng(file, traffic, name="ttyUSB0") == 2
    data, blocks = file.getvalue(), []
    at = 0
    while at < len(data):
        kind, size = struct.unpack_from("<II", data, at)
        assert size % 4 == 0
        assert struct.unpack_from("<I", data, at + size - 4) == (size,)
        blocks.append((kind, data[at + 8 : at + size - 4]))
        at += size
    assert [kind for kind, _ in blocks] == [0x0A0D0D0A, 1, 6, 6]
    assert b"ttyUSB0" in blocks[1][1]
    for (_, packet), passed, flag in zip(blocks[2:], traffic, (2, 1), strict=True):
        _, high, low, length, original = struct.unpack_from("<IIIII", packet)
        assert (high << 32 | low) == round(passed.time * 1e9)
        assert length == original == len(passed.data)
        assert packet[20 : 20 + length] == passed.data
        options = packet[20 + length + -length % 4 :]
        assert struct.unpack_from("<HHI", options) == (2, 4, flag)

from __future__ import annotations

import io
import shutil
import struct
import subprocess
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st
from tests.analyzers.lines import assembled
from tests.frames import frame_bytes

from hexwire.link.tap import Direction, Passed
from hexwire.trace.pcap import is_pcap, read_pcap, write_pcapng
from hexwire.trace.sources import read_traffic

ROOT = Path(__file__).parents[2]
ETHERNET = 1


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


def pcapng(traffic: list[Passed]) -> bytes:
    file = io.BytesIO()
    write_pcapng(file, traffic)
    return file.getvalue()


TRAFFIC = [
    Passed(Direction.SENT, frame_bytes(2, b"abc", proto=1, seq=1, src=7, dst=8), 3.25, ""),
    Passed(Direction.RECEIVED, b"ab", 3.5, ""),
]


def classic(order: str, link: int = 147, magic: int = 0xA1B23C4D) -> bytes:
    packet = TRAFFIC[0].data
    head = struct.pack(order + "IHHiIII", magic, 2, 4, 0, 0, 65535, link)
    return head + struct.pack(order + "IIII", 3, 250_000_000, len(packet), len(packet)) + packet


def test_what_was_written_is_read_back() -> None:
    assert list(read_pcap(pcapng(TRAFFIC))) == TRAFFIC
    assert list(read_traffic(pcapng(TRAFFIC))) == TRAFFIC


def test_an_old_pcap_is_read_in_either_byte_order_and_its_direction_guessed() -> None:
    for order in "<>":
        data = classic(order)
        assert is_pcap(data)
        first, remark = read_pcap(data)
        assert first == TRAFFIC[0]
        assert "no direction" in str(remark)
    (cut,) = [each for each in read_pcap(classic("<")[:-1]) if isinstance(each, str)]
    assert cut == "the file is cut short or damaged at byte 24"


def test_a_capture_of_a_network_says_so() -> None:
    (remark,) = read_pcap(classic("<", link=ETHERNET))
    assert "open the file in Wireshark" in str(remark)


def test_a_file_that_is_cut_gives_what_is_before_the_cut() -> None:
    whole = pcapng(TRAFFIC)
    first, remark = read_pcap(whole[:-3])
    assert first == TRAFFIC[0]
    assert "cut short or damaged at byte" in str(remark)


def test_wireshark_reads_the_file_and_its_dissector_explains_it() -> None:
    assert shutil.which("tshark")
    capture = ROOT / "vectors" / "captures" / "cut-frame.pcapng"
    (first, *_) = read_pcap(capture.read_bytes())
    assert isinstance(first, Passed)
    again = pcapng([first])
    script = assembled() / "wireshark" / "hexwire.lua"
    command = ["tshark", "-X", f"lua_script:{script}", "-r", "-", "-T", "fields", "-e", "hexwire.reading"]
    done = subprocess.run(command, input=again, capture_output=True, check=False, timeout=60)
    assert done.stdout.decode().strip() == "1 READ seq 47: read 0: present_position, 2 bytes"


@given(st.binary(max_size=60), st.integers(0, 300), st.integers(0, 255))
def test_any_bytes_are_read_without_an_error(tail: bytes, place: int, byte: int) -> None:
    for whole in (pcapng(TRAFFIC), classic("<"), classic(">", magic=0xA1B2C3D4)):
        spoilt = bytearray(whole + tail)
        spoilt[place % len(spoilt)] = byte
        passed = [each for each in read_pcap(bytes(spoilt)) if isinstance(each, Passed)]
        assert sum(len(each.data) for each in passed) <= len(spoilt)

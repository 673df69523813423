"""The Wireshark dissector, run by tshark on captures made here."""

from __future__ import annotations

import json
import os
import random
import socket
import struct
import subprocess
from collections.abc import Iterable, Sequence
from itertools import product
from pathlib import Path
from typing import Any, BinaryIO

import pytest
from tests.analyzers.lines import assembled, readings_table
from tests.few import few
from tests.frames import frame_bytes

from hexwire.link.tap import Direction, Passed
from hexwire.trace.pcap import USER0, write_pcapng
from hexwire.wire.command_frame import Command, parse_frame
from hexwire.wire.commands import FragmentHead, Stats
from hexwire.wire.servo_packet import make_read, make_status, make_sync_write

ROOT = Path(__file__).resolve().parents[2]
VECTORS = [json.loads(line) for line in (ROOT / "vectors/session.jsonl").read_text().splitlines()]
GOOD = [vector for vector in VECTORS if vector["kind"] == "frame"]
HOST, BOARD = 7, 8
ETHERNET = 1
CLIENT_PORT = 54321
"""No protocol's in any Wireshark: 4.4 takes what comes from port 40000 for another one."""
CHAPTER_PAIR = [bytes.fromhex(vector["hex"]) for vector in GOOD[:2]]


def tshark(capture: Path, *arguments: str, fields: Sequence[str] = ()) -> list[list[str]]:
    """Rows of `fields`, a packet each; several values of a field are separated by |."""
    command = [
        "tshark",
        "-X",
        f"lua_script:{assembled()}/wireshark/hexwire.lua",
        "-r",
        str(capture),
        *arguments,
        "-T",
        "fields",
    ]
    command += ["-E", "separator=/t", "-E", "aggregator=|"]
    for field in fields:
        command += ["-e", field]
    environment = os.environ | {"HOME": str(capture.parent), "XDG_CONFIG_HOME": str(capture.parent)}
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    assert "Lua" not in done.stderr, done.stderr
    assert "Lua Error" not in done.stdout
    return [line.split("\t") for line in done.stdout.splitlines()]


def serial(path: Path, packets: Sequence[bytes], step: float = 0.001) -> Path:
    with path.open("wb") as file:
        write_pcap(file, [(1000 + step * i, data) for i, data in enumerate(packets)])
    return path


def readings(capture: Path, *arguments: str) -> list[str]:
    rows = tshark(capture, *arguments, fields=["hexwire.reading"])
    return [text for row in rows for text in row[0].split("|") if text]


def write_pcap(file: BinaryIO, packets: Iterable[tuple[float, bytes]], *, link_type: int = USER0) -> None:
    """A capture with nanosecond stamps, as other programs write it."""
    file.write(struct.pack("<IHHiIII", 0xA1B23C4D, 2, 4, 0, 0, 0x40000, link_type))
    for time, data in packets:
        sec, nsec = divmod(round(time * 1e9), 10**9)
        file.write(struct.pack("<IIII", sec, nsec, len(data), len(data)) + data)


def frame(
    cmd: int, body: bytes, *, seq: int = 1, ext: int = 0, sent: bool = True, proto: int = 2, nsec: int = 0
) -> bytes:
    src, dst = (HOST, BOARD) if sent else (BOARD, HOST)
    return frame_bytes(
        cmd, body, proto=proto, seq=seq, src=src, dst=dst, type=3 if sent else 8, time_nsec=nsec, cmd_ext=ext
    )


def _checksum(data: bytes) -> int:
    total = sum(struct.unpack(f">{len(data) // 2}H", data))
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    return ~total & 0xFFFF


def _ip(protocol: int, sent: bool, payload: bytes) -> bytes:
    ends = [bytes([127, 0, 0, 1]), bytes([127, 0, 0, 2])]
    if not sent:
        ends.reverse()
    head = struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(payload), 0, 0, 64, protocol, 0) + ends[0] + ends[1]
    head = head[:10] + struct.pack(">H", _checksum(head)) + head[12:]
    return bytes(12) + b"\x08\0" + head + payload


def network(path: Path, traffic: Sequence[tuple[bool, bytes]], *, tcp: bool, port: int) -> Path:
    """A capture of a network: TCP segments or UDP datagrams as given, 1 ms apart."""
    numbers = {True: 1, False: 1}
    packets = []
    for i, (sent, data) in enumerate(traffic):
        ports = (CLIENT_PORT, port) if sent else (port, CLIENT_PORT)
        if tcp:
            head = struct.pack(">HHIIBBHHH", *ports, numbers[sent], numbers[not sent], 0x50, 0x18, 0xFFFF, 0, 0)
            numbers[sent] += len(data)
            packets.append((1000 + i * 0.001, _ip(6, sent, head + data)))
        else:
            packets.append((1000 + i * 0.001, _ip(17, sent, struct.pack(">HHHH", *ports, 8 + len(data), 0) + data)))
    with path.open("wb") as file:
        write_pcap(file, packets, link_type=ETHERNET)
    return path


def test_reads_as_the_table_says(tmp_path: Path) -> None:
    """Every row, ten seconds and a run of its own apart: what one row left open must not reach the next."""
    table = readings_table()
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in table:
        groups.setdefault((row["line"], row.get("series", "board")), []).append(row)
    for (line, series), rows in groups.items():
        packets = []
        for number, row in enumerate(rows):
            for i, (_, data) in enumerate(row["transfers"]):
                packets.append((1000 + 10 * number + i / 1000, bytes.fromhex(data)))
        path = tmp_path / f"{line}-{series}.pcap"
        with path.open("wb") as file:
            write_pcap(file, packets)
        arguments = ("-o", f"hexwire.series:{series}", "-o", f"hexwire.line:{line}")
        found = tshark(path, *arguments, fields=["frame.time_epoch", "hexwire.reading"])
        by_row: dict[int, list[str]] = {}
        for time, text in found:
            by_row.setdefault(int((float(time) - 1000) // 10), []).extend(part for part in text.split("|") if part)
        for number, row in enumerate(rows):
            assert by_row[number] == row["readings"], row["name"]


def test_every_good_vector_has_its_fields(tmp_path: Path) -> None:
    names = [
        "time_sec",
        "time_nsec",
        "sn",
        "src",
        "dst",
        "type",
        "size",
        "dialect",
        "seq",
        "cmd",
        "cmd_ext",
        "check",
    ]
    capture = serial(tmp_path / "v.pcap", [bytes.fromhex(vector["hex"]) for vector in GOOD])
    rows = tshark(capture, fields=[f"hexwire.{name}" for name in [*names, "body"]])
    assert len(rows) == len(GOOD) > 10
    for vector, row in zip(GOOD, rows, strict=True):
        wanted = [vector["proto" if name == "dialect" else name] for name in names]
        assert [int(text, 0) for text in row[:-1]] == wanted, vector["name"]
        assert bytes.fromhex(row[-1]) == bytes.fromhex(vector["body"]), vector["name"]


def test_every_bad_vector_is_marked(tmp_path: Path) -> None:
    bad = [vector for vector in VECTORS if vector["kind"] == "bad"]
    # A datagram has an end, so that a frame cut short is known at once.
    traffic = [(True, bytes.fromhex(vector["hex"])) for vector in bad]
    capture = network(tmp_path / "b.pcap", traffic, tcp=False, port=15030)
    found = tshark(capture, fields=["_ws.expert", "hexwire.reading"])
    assert len(found) == len(bad) > 5
    for vector, (marked, text) in zip(bad, found, strict=True):
        name, reason = vector["name"], vector["reason"]
        assert marked, name
        if reason.startswith("tail is 0A 0A"):
            assert text.endswith("! tail 0A 0A, the port was left with ICRNL"), name
        elif reason.startswith("check is"):
            assert text.startswith(f"bad frame: {reason}"), name
        elif reason == "cut short":
            assert text == "bad frame: cut short, 43 of 44 bytes", name
        elif "after the frame" in reason:
            assert text.endswith("|garbage: 1 bytes"), name
        else:
            assert text == f"garbage: {len(bytes.fromhex(vector['hex']))} bytes", name


def test_a_serial_capture_may_be_cut_anywhere(tmp_path: Path) -> None:
    whole = [bytes.fromhex(vector["hex"]) for vector in GOOD]
    stream = b"".join(whole)
    ways = {"frame": whole} | {
        f"{step} bytes": [stream[i : i + step] for i in range(0, len(stream), step)] for step in (1, 7, 41, 200)
    }
    path = tmp_path / "pieces.pcap"
    with path.open("wb") as file:
        # A run for all, with so much silence between them that nothing is left open.
        write_pcap(
            file,
            [
                (1000 + 100 * number + i / 1000, piece)
                for number, pieces in enumerate(ways.values())
                for i, piece in enumerate(pieces)
            ],
        )
    found = readings(path)
    assert len(found) == len(ways) * len(whole)
    for number, way in enumerate(ways):
        part = found[number * len(whole) : (number + 1) * len(whole)]
        assert part == found[: len(whole)], f"a packet for each {way}"


def test_noise_between_frames_is_shown_and_harms_none(tmp_path: Path) -> None:
    request, answer = CHAPTER_PAIR
    capture = serial(tmp_path / "n.pcap", [b"\x00\x5a\xfa", request, b"noise", answer])
    assert readings(capture) == [
        "garbage: 1 bytes",
        "garbage: 2 bytes",
        "1 READ seq 46: read 6: present_load, 2 bytes",
        "garbage: 5 bytes",
        "1 READ seq 45: status 6: present_load 52 = 5.2 percent PWM duty",
    ]


def test_an_unfinished_frame_is_given_up_after_silence(tmp_path: Path) -> None:
    request, answer = CHAPTER_PAIR
    capture = serial(tmp_path / "s.pcap", [request[:20], answer], step=0.1)
    assert readings(capture) == ["bad frame: cut short, 20 of 40 bytes", "1 READ seq 45: status 6: 34 00"]


@few("tcp, port", product([True, False], [15030, 23456]), (True, 15030), (False, 23456))
def test_answers_find_their_requests_over_a_network(tmp_path: Path, tcp: bool, port: int) -> None:
    request, answer = CHAPTER_PAIR
    traffic = [(True, request), (False, answer)]
    traffic.append((True, frame(Command.IDENTIFY, b"", seq=5)))
    traffic.append((False, frame(Command.RESUME, b"\0", seq=4, ext=0x80, sent=False)))
    traffic.append((False, frame(Command.IDENTIFY, b"", seq=5, ext=0x84, sent=False)))
    capture = network(tmp_path / "n.pcap", traffic, tcp=tcp, port=port)
    fields = ["hexwire.response_in", "hexwire.response_to", "hexwire.response_time", "hexwire.status"]
    rows = tshark(capture, "-2", fields=fields)
    assert [row[:2] for row in rows] == [["2", ""], ["", "1"], ["5", ""], ["", ""], ["", "3"]]
    assert [round(float(row[2]), 6) for row in rows if row[2]] == [0.001, 0.002]
    assert [row[3] for row in rows] == ["", "", "", "0", "4"]


def test_tcp_segments_may_cut_frames_anywhere(tmp_path: Path) -> None:
    frames = [bytes.fromhex(vector["hex"]) for vector in GOOD if vector["src"] == HOST]
    stream = b"noise" + b"".join(frames)
    wanted = readings(serial(tmp_path / "s.pcap", frames))
    for step in (13, 100):
        pieces = [(True, stream[i : i + step]) for i in range(0, len(stream), step)]
        found = readings(network(tmp_path / "t.pcap", pieces, tcp=True, port=15030))
        assert [text for text in found if not text.startswith("garbage")] == wanted, f"segments of {step} bytes"
        assert sum(int(text.split()[1]) for text in found if text.startswith("garbage")) == 5, step


def test_the_port_is_a_preference(tmp_path: Path) -> None:
    # No frame begins here, so that the heuristics do not help.
    capture = network(tmp_path / "p.pcap", [(True, b"x" + CHAPTER_PAIR[0])], tcp=False, port=777)
    assert readings(capture) == []
    assert readings(capture, "-o", "hexwire.udp_port:777")[0] == "garbage: 1 bytes"


def test_fragments_come_together(tmp_path: Path) -> None:
    body = Stats({"uptime_ms": 70000, "bus_retries": 3}).serialize()
    chunks = [body[i : i + 24] for i in range(0, len(body), 24)]
    head = FragmentHead.parse(struct.pack("<HHHBB", 9, 0, len(chunks), Command.STATS, 0x80))
    assert head.chunks == len(chunks)
    packets = [
        frame(Command.FRAGMENT, struct.pack("<HHHBB", 9, i, len(chunks), Command.STATS, 0x80) + chunk, seq=i)
        for i, chunk in enumerate(chunks)
    ]
    packets[0], packets[1] = packets[1], packets[0]
    fields = [
        "hexwire.fragment.index",
        "hexwire.fragment.count",
        "hexwire.fragment.size",
        "hexwire.fragment.reading",
    ]
    rows = tshark(serial(tmp_path / "f.pcap", packets), fields=fields)
    assert [row[0] for row in rows] == ["1", "0", *map(str, range(2, len(chunks)))]
    assert [row[2] for row in rows] == [""] * (len(chunks) - 1) + [str(len(body))]
    assert rows[-1][3].startswith("STATS: uptime_ms 70000, frames_received 0")


def test_hazards_are_expert_information(tmp_path: Path) -> None:
    marker = frame(2, make_read(0, 56, 2), proto=1, nsec=0x0A0D)
    block = frame(3, make_sync_write(42, {4: bytes.fromhex("00 08 E8 03")}), proto=1)
    plain = frame(3, make_sync_write(42, {0: bytes.fromhex("00 08 E8 03")}), proto=1)
    modern = frame(2 + 0x18, b"\x08\x0a" + make_read(0, 56, 2), nsec=0x0A0D)
    capture = serial(tmp_path / "h.pcap", [marker, block, plain, modern])
    fields = ["hexwire.hazard.marker", "hexwire.hazard.ceiling", "_ws.expert.severity"]
    rows = tshark(capture, fields=fields)
    assert [[bool(value) for value in row[:2]] for row in rows] == [
        [True, False],
        [False, True],
        [False, False],
        [False, False],
    ]
    assert [row[2] for row in rows][2:] == ["", ""]
    assert len(tshark(capture, "-Y", "hexwire.hazard.ceiling", fields=["frame.number"])) == 1


def test_bad_checksums_can_be_filtered_for(tmp_path: Path) -> None:
    good = make_read(4, 56, 2)
    bad = good[:-1] + bytes([good[-1] ^ 1])
    capture = serial(tmp_path / "bus.pcap", [good, bad, make_status(4, 0, b"\0\x08")])
    assert [row[0] for row in tshark(capture, "-Y", "hexwire.bad_checksum", fields=["frame.number"])] == ["2"]
    assert readings(capture) == [
        "read 4: present_position, 2 bytes",
        f"bad packet: checksum {bad[-1]:02X}, not {good[-1]:02X}",
        "status 4: present_position 2048 = 180 deg",
    ]


def test_a_pcapng_keeps_the_two_ways_apart(tmp_path: Path) -> None:
    request, answer = CHAPTER_PAIR
    parts = [(Direction.SENT, request[:30]), (Direction.RECEIVED, answer[:25]), (Direction.SENT, request[30:])]
    parts.append((Direction.RECEIVED, answer[25:]))
    path = tmp_path / "d.pcapng"
    with path.open("wb") as file:
        write_pcapng(file, [Passed(way, data, 5 + i / 1000, "") for i, (way, data) in enumerate(parts)])
    assert readings(path) == [
        "1 READ seq 46: read 6: present_load, 2 bytes",
        "1 READ seq 45: status 6: present_load 52 = 5.2 percent PWM duty",
    ]


def _capture_loopback(path: Path, request: bytes, answer: bytes) -> int:
    """Exchange a request and its answer over UDP on the loopback and capture it; the status of the capture."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as board,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as host,
    ):
        board.bind(("127.0.0.1", 0))
        port = board.getsockname()[1]
        command = ["tshark", "-i", "lo", "-f", f"udp port {port}", "-c", "2", "-a", "duration:20", "-w", str(path)]
        with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as process:
            assert process.stderr is not None
            for line in process.stderr:
                if "Capturing on" in line:
                    break
            # The kernel's filter may come a moment after that line: say it until it was heard.
            host.connect(("127.0.0.1", port))
            for _ in range(20):
                host.send(request)
                data, where = board.recvfrom(8192)
                board.sendto(answer, where)
                assert (data, host.recv(8192)) == (request, answer)
                try:
                    process.communicate(timeout=1.0)
                    break
                except subprocess.TimeoutExpired:
                    continue
            return process.wait()


@pytest.mark.slow
@pytest.mark.system
def test_traffic_captured_on_the_loopback(tmp_path: Path) -> None:
    request, answer = CHAPTER_PAIR
    path = tmp_path / "lo.pcapng"
    if _capture_loopback(path, request, answer) != 0:
        # Where capturing is not permitted: the same bytes, written.
        network(path, [(True, request), (False, answer)], tcp=False, port=40001)
    assert readings(path) == [
        "1 READ seq 46: read 6: present_load, 2 bytes",
        "1 READ seq 45: status 6: present_load 52 = 5.2 percent PWM duty",
    ]


def test_random_bytes_raise_no_error(tmp_path: Path) -> None:
    source = random.Random(7)
    frames = [bytes.fromhex(vector["hex"]) for vector in VECTORS]
    spoilt = []
    for _ in range(300):
        data = bytearray(source.choice(frames))
        for _ in range(source.randrange(1, 4)):
            data[source.randrange(len(data))] = source.randrange(256)
        spoilt.append(bytes(data))
    # Also with a right check, so that the bodies are looked into.
    for _ in range(300):
        cmd, body = source.randrange(0x40), source.randbytes(source.randrange(40))
        spoilt.append(frame(cmd, body, ext=source.choice([0, 0x40, 0x80, 0x85])))
        parse_frame(spoilt[-1])
    assert len(readings(serial(tmp_path / "r.pcap", spoilt))) >= 300
    assert readings(serial(tmp_path / "q.pcap", [b"\xff\xff" + source.randbytes(20) for _ in range(100)]))


def test_conversations_over_datagrams_read_as_any_frame(tmp_path: Path) -> None:
    rows = [json.loads(line) for line in (ROOT / "vectors/conversation.jsonl").read_text().splitlines()]
    steps = [(row["role"] == "host", step) for row in rows for step in row["steps"]]
    traffic = [((step["what"] == "asks") == host, bytes.fromhex(step["hex"])) for host, step in steps]
    capture = network(tmp_path / "udp.pcap", traffic, tcp=False, port=15030)
    found = tshark(capture, fields=["hexwire.sn", "hexwire.type", "hexwire.cmd"])
    assert len(found) == len(traffic)
    for (_, data), (sn, kind, cmd) in zip(traffic, found, strict=True):
        frame = parse_frame(data)
        assert (int(sn), int(kind), int(cmd, 0)) == (frame.sn, frame.type, frame.cmd)

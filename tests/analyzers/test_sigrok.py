"""The sigrok decoders, run by sigrok-cli on captures made here."""

from __future__ import annotations

import bisect
import os
import random
import re
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from tests.analyzers.lines import (
    OVERSAMPLING,
    RX,
    TX,
    Sent,
    assembled,
    duration,
    in_turn,
    merged,
    readings_table,
    samples,
)

from hexwire.wire.servo_packet import (
    make_legacy_ping_status,
    make_ping,
    make_read,
    make_status,
    make_sync_read,
    make_write,
)

BAUD = 115200
PAUSE = 0.06
"""Seconds after which every decoder has given up what was unfinished."""


def sigrok(
    tmp_path: Path,
    decoder: str,
    traffic: Sequence[Sent],
    *,
    baud: int = BAUD,
    show: str = "",
    series: str = "board",
    noise: float = 0.0,
    lines: str = "rx=0:tx=1",
    placed: bool = False,
) -> list[str]:
    """Annotations of a decoder, in order; each after the number of its first sample if `placed`."""
    capture = tmp_path / "capture.bin"
    capture.write_bytes(samples(traffic, baud, noise=noise))
    stack = f"uart:{lines}:baudrate={baud},{decoder}:series={series}"
    command = ["sigrok-cli", "-i", str(capture), "-I", f"binary:numchannels=2:samplerate={baud * OVERSAMPLING}"]
    command += ["-P", stack, "-A", f"{decoder}={show}" if show else decoder]
    command += ["--protocol-decoder-samplenum"] if placed else []
    environment = os.environ | {"SIGROKDECODE_DIR": str(assembled() / "sigrok"), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    assert "rror" not in done.stderr, done.stderr
    if placed:
        return [re.sub(r"^(\d+)-\d+ [\w-]+: ", r"\1 ", line) for line in done.stdout.splitlines()]
    return [re.sub(r"^[\w-]+: ", "", line) for line in done.stdout.splitlines()]


FRAMES = "frame:bad:garbage"
PACKETS = "request:status:bad:garbage"


def test_reads_as_the_table_says(tmp_path: Path) -> None:
    """A run for all rows of a line and a series, with silence between them, after which no transfer is left open.

    Questions are, so those rows come first that begin with an answer.
    """
    ways = {"host": TX, "board": RX}
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in sorted(readings_table(), key=lambda row: row["transfers"][0][0] == "host"):
        groups.setdefault((row["line"], row.get("series", "board")), []).append(row)
    for (line, series), rows in groups.items():
        on_host = line == "host"
        traffic: list[Sent] = []
        starts: list[float] = []
        for row in rows:
            transfers = [(ways[way] if on_host else RX, bytes.fromhex(data)) for way, data in row["transfers"]]
            starts.append(traffic[-1].time + duration(traffic[-1].data, BAUD) + PAUSE if traffic else 0.0)
            in_it = in_turn(transfers, BAUD, 0.001 if on_host else 0.0003)
            traffic += [sent._replace(time=sent.time + starts[-1]) for sent in in_it]
        found = sigrok(
            tmp_path,
            "hexwire_host" if on_host else "hexwire_servo",
            traffic,
            show=FRAMES if on_host else PACKETS,
            series=series,
            lines="rx=0:tx=1" if on_host else "rx=0",
            placed=True,
        )
        by_row: dict[int, list[str]] = {}
        for text in found:
            sample, _, reading = text.partition(" ")
            number = bisect.bisect(starts, int(sample) / (BAUD * OVERSAMPLING)) - 1
            by_row.setdefault(number, []).append(re.sub(r"^[RT]X: ", "", reading) if on_host else reading)
        for number, row in enumerate(rows):
            assert merged(by_row[number]) == merged(row["readings"]), row["name"]


def test_the_bus_at_a_megabaud_with_turn_around_times(tmp_path: Path) -> None:
    baud, gap = 1_000_000, 0.0001
    conversation = [make_sync_read(56, 2, [4, 5]), make_status(4, 0, b"\0\x08"), make_status(5, 0, b"\1\x08")]
    traffic = in_turn([(RX, data) for data in conversation], baud, gap)
    found = sigrok(tmp_path, "hexwire_servo", traffic, baud=baud, lines="rx=0", show=f"{PACKETS}:turn")
    turns = [float(re.findall(r"turn-around ([\d.]+) us", text)[0]) for text in found if "turn-around" in text]
    assert len(turns) == 2
    # A bit is 1 us; the decoder may see the middle of the last stop bit only.
    assert all(abs(turn - 100) <= 1 for turn in turns)
    assert [text for text in found if "turn-around" not in text] == [
        "sync read 4 5: present_position, 2 bytes",
        "status 4: present_position 2048 = 180 deg",
        "status 5: present_position 2049 = 180.088 deg",
    ]


def test_the_time_to_an_answer_on_the_host_link(tmp_path: Path) -> None:
    row = readings_table()[0]
    request, answer = (bytes.fromhex(data) for _, data in row["transfers"][:2])
    found = sigrok(tmp_path, "hexwire_host", in_turn([(TX, request), (RX, answer)], BAUD, 0.005), show="time")
    assert [float(re.findall(r"([\d.]+) ms", text)[0]) for text in found] == [pytest.approx(5.0, abs=0.02)]


def test_the_parts_of_a_frame_are_named(tmp_path: Path) -> None:
    request = bytes.fromhex(readings_table()[0]["transfers"][0][1])
    found = sigrok(tmp_path, "hexwire_host", in_turn([(TX, request)], BAUD, 0.001), show="part")
    assert found[0] == "sync"
    assert {"sn 46", "from ARM_7BOT_SERIAL_TRX", "to ARM_7BOT_ARDUINO_TRX", "size 52", "body", "tail"} <= set(found)


def test_both_sides_at_once_are_a_collision(tmp_path: Path) -> None:
    ping = make_ping(4)
    late = duration(ping, BAUD) / 2
    clash = [Sent(TX, 0.001, ping), Sent(RX, 0.001 + late, make_status(4))]
    found = sigrok(tmp_path, "hexwire_servo", clash, show="line")
    assert found
    assert set(found) == {"collision: both sides send"}
    clean = in_turn([(TX, ping), (RX, make_status(4))], BAUD, 0.0002)
    assert sigrok(tmp_path, "hexwire_servo", clean, show="line") == []


def test_both_headers_and_the_odd_ping_answer(tmp_path: Path) -> None:
    traffic = [(RX, make_ping(1)), (RX, make_legacy_ping_status(1)), (RX, make_ping(4)), (RX, make_status(4))]
    found = sigrok(tmp_path, "hexwire_servo", in_turn(traffic, BAUD, 0.0002), show=PACKETS, lines="rx=0")
    assert found == ["ping 1", "status 1 legacy", "ping 4", "status 4"]


def test_a_hazard_has_a_row_of_its_own(tmp_path: Path) -> None:
    block = make_write(4, 42, bytes.fromhex("00 08 E8 03"))
    found = sigrok(tmp_path, "hexwire_servo", in_turn([(RX, block)], BAUD, 0.0002), show="hazard", lines="rx=0")
    assert found == ["run time in the current ceiling of an HLS servo"]


@pytest.mark.parametrize("decoder", ["hexwire_servo", "hexwire_host"])
def test_noise_spoils_what_it_hits_and_nothing_else(tmp_path: Path, decoder: str) -> None:
    row = readings_table()[0]
    if decoder == "hexwire_host":
        pair = [(TX, bytes.fromhex(row["transfers"][0][1])), (RX, bytes.fromhex(row["transfers"][1][1]))]
        # Silence long enough that a spoilt frame is given up before the next one.
        gap, wanted, kinds = 0.060, {f"{'RT'[i == 0]}X: {row['readings'][i]}" for i in (0, 1)}, FRAMES
    else:
        pair = [(RX, make_read(4, 56, 2)), (RX, make_status(4, 0, b"\0\x08"))]
        wanted = {"read 4: present_position, 2 bytes", "status 4: present_position 2048 = 180 deg"}
        gap, kinds = 0.005, PACKETS
    traffic = in_turn(pair * 12, BAUD, gap)
    assert set(sigrok(tmp_path, decoder, traffic, show=kinds)) == wanted
    found = sigrok(tmp_path, decoder, traffic, show=kinds, noise=0.01)
    assert any(text.split(": ", decoder == "hexwire_host")[-1].startswith(("bad", "garbage")) for text in found)
    sound = [text for text in found if text in wanted]
    assert len(sound) >= 3


@pytest.mark.parametrize(("error", "sound"), [(0.01, True), (-0.01, True), (0.12, False), (-0.12, False)])
def test_a_wrong_baud_rate_is_seen(tmp_path: Path, error: float, sound: bool) -> None:
    packet = make_read(4, 56, 2)
    traffic = [Sent(RX, 0.001 + i * 0.01, packet, 1 + error) for i in range(4)]
    found = sigrok(tmp_path, "hexwire_servo", traffic, show=PACKETS, lines="rx=0")
    faults = sigrok(tmp_path, "hexwire_servo", traffic, show="line", lines="rx=0")
    if sound:
        assert found == ["read 4: present_position, 2 bytes"] * 4
        assert faults == []
    else:
        assert "read 4: present_position, 2 bytes" not in found
        assert faults


def test_random_bytes_raise_no_error(tmp_path: Path) -> None:
    source = random.Random(3)
    noise = b"".join(source.choice([b"\xff\xff", b"\xff\xf5", b""]) + source.randbytes(9) for _ in range(60))
    for decoder in ("hexwire_servo", "hexwire_host"):
        sigrok(tmp_path, decoder, [Sent(RX, 0.001, noise), Sent(TX, 0.0, noise[::-1])])

"""Telling logs, hex dumps and raw captures apart."""

from __future__ import annotations

import contextlib
import json
import resource
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.interpreter import longest_hold

from hexwire.errors import UsageError
from hexwire.link.tap import Direction, Passed
from hexwire.trace.mcap_file import MAGIC
from hexwire.trace.sources import read_traffic

FRAME = bytes.fromhex("5AFAFA5A0100000000000000010000000700000008000000030000002C0000008202010000001000AB120D0A")


def transfers(data: bytes) -> list[tuple[Direction, bytes]]:
    return [(t.direction, t.data) for t in read_traffic(data) if isinstance(t, Passed)]


def test_a_raw_capture_is_one_transfer() -> None:
    assert transfers(FRAME) == [(Direction.SENT, FRAME)]
    from_board = FRAME[:16] + b"\x08\0\0\0\x07\0\0\0" + FRAME[24:]
    assert transfers(from_board) == [(Direction.RECEIVED, from_board)]


@pytest.mark.parametrize(
    "text",
    [
        FRAME.hex(),
        FRAME.hex(" "),
        FRAME.hex(" ").upper().replace(" ", ", 0x"),
        "\n".join(f"{i:08x}  {FRAME[i : i + 16].hex(' ')}  |text|" for i in range(0, len(FRAME), 16)),
        "\n".join(f"{i:04x}: {FRAME[i : i + 16].hex(' ')}  Z..Z" for i in range(0, len(FRAME), 16)),
        "# a note\n" + FRAME.hex(" "),
    ],
)
def test_hex_dumps_of_several_makes(text: str) -> None:
    assert transfers(text.encode()) == [(Direction.SENT, FRAME)]


def test_arrows_and_blank_lines_part_transfers() -> None:
    text = "> FF FF 01 02 01 FB\n< FF FF 01 02 00 FC\n\nFF F5 01 02 00 FC\n"
    assert transfers(text.encode()) == [
        (Direction.SENT, bytes.fromhex("FFFF010201FB")),
        (Direction.RECEIVED, bytes.fromhex("FFFF010200FC")),
        (Direction.RECEIVED, bytes.fromhex("FFF5010200FC")),
    ]


def test_lines_that_are_neither_are_named() -> None:
    remarks = [item for item in read_traffic(b"FF FF 01 02 01 FB\nhello world\n") if isinstance(item, str)]
    assert remarks == ["line 2 is neither hex nor a log line: hello world"]
    remarks = [item for item in read_traffic(b"> FF FF 01 02 01 FB\n> X FF\n") if isinstance(item, str)]
    assert remarks == ["line 2 is neither hex nor a log line: X FF"]


def test_an_empty_file_is_an_error() -> None:
    with pytest.raises(UsageError, match="empty"):
        list(read_traffic(b" \n"))


@given(st.binary(min_size=1, max_size=300))
def test_any_file_is_read_without_a_stray_exception(data: bytes) -> None:
    try:
        list(read_traffic(data))
    except UsageError:
        assert not data.strip() or data.startswith(MAGIC)


HOSTILE = {
    "blanks": b" " * 200_000 + b"x",
    "blanks behind hex": b"FF FF" + b" " * 200_000 + b"x",
    "blanks in lines": (b" " * 3000 + b"x\n") * 60,
    "tabs before a bar": b"FF" + b"\t" * 200_000 + b"|",
    "blanks in a headline": b"1.5" + b" " * 200_000 + b"x",
    "digits": b"1" * 200_001,
    "a length of many digits": b"SerialPort sent - Length=" + b"9" * 200_000,
    "bars": b"|" * 200_000,
    "arrows": b"<>" * 100_000,
}


def test_a_file_made_to_be_slow_is_not() -> None:
    """All of them in processor time, ten times what they take: the square of these lengths would be hours."""
    code = (
        "import json, sys; from hexwire.trace.sources import read_traffic\n"
        "for name, text in json.load(sys.stdin).items():\n"
        "    print(name, flush=True)\n"
        "    list(read_traffic(text.encode('latin-1')))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        input=json.dumps({name: data.decode("latin-1") for name, data in HOSTILE.items()}).encode(),
        capture_output=True,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (60, 60)),
    )
    assert (done.returncode, done.stderr) == (0, b""), f"at the last of {done.stdout.decode().splitlines()}"
    assert done.stdout.decode().splitlines() == list(HOSTILE)


_LONG = 8 * 1024 * 1024
LONG_LINES = {
    "bytes": b"FF " * (_LONG // 3),
    "bytes without blanks": b"ff" * (_LONG // 2),
    "letters": b"x" * _LONG,
    "blanks": b" " * _LONG + b"x",
    "blanks alone": b" " * _LONG,
    "letters of others": "\u00e9".encode() * (_LONG // 2),
}


@pytest.mark.parametrize("data", LONG_LINES.values(), ids=LONG_LINES.keys())
def test_a_long_line_keeps_no_other_thread_waiting(data: bytes) -> None:
    def read() -> None:
        with contextlib.suppress(UsageError):
            list(read_traffic(data))

    # On a busy machine every thread waits for a processor now and then, so the best of some. Where such a line is
    # read as a whole, it takes 0.05 to 0.3 s.
    assert min(longest_hold(read) for _ in range(5)) < 0.02


@pytest.mark.parametrize("between", ["", " ", ", 0x", "  ", "\t"])
@pytest.mark.parametrize("before", ["", "> ", "00000000: ", " " * 40_000])
def test_a_long_line_of_hex_is_read_to_its_end(before: str, between: str) -> None:
    data = bytes(number % 251 for number in range(40_000))
    if not between:
        # Only two digits show that what is before them is an offset.
        before = before.removeprefix("00000000: ")
    line = before + between.join(f"{each:02x}" for each in data)
    for end in ("", "  |text|", " # a note of 10 bytes", " " * 40_000, " " * 40_000 + "text"):
        assert transfers((line + end).encode()) == [(Direction.SENT, data)]
    assert transfers((line + " hello").encode()) == []


def test_a_log_whose_length_is_no_number() -> None:
    text = f"SerialPort sent - Length={'9' * 5000}\nFF FF 01 02 01 FB\n"
    assert [str(item)[:40] for item in read_traffic(text.encode())][:1] == [
        "line 1 is neither hex nor a log line: Se"
    ]


def test_a_file_that_is_too_large_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hexwire.trace.sources.LARGEST", 1 << 20)
    with pytest.raises(UsageError, match=r"capture\.bin is larger than 1 MiB"):
        list(read_traffic(bytes((1 << 20) + 1) + b"x", "capture.bin"))


def test_a_mark_of_byte_order_and_windows_line_ends_make_no_difference() -> None:
    dump = "\n".join(FRAME[i : i + 8].hex(" ") for i in range(0, len(FRAME), 8))
    for data in (dump.encode("utf-8-sig"), dump.replace("\n", "\r\n").encode(), dump.encode("utf-8-sig") + b"\r\n"):
        assert transfers(data) == [(Direction.SENT, FRAME)]

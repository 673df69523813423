"""Recordings that are cut off, spoilt, or made to fill a memory."""

from __future__ import annotations

import io
import resource
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from tests.recorded import make_positions

from hexwire.errors import UsageError
from hexwire.trace.mcap_file import MAGIC, load_mcap, read_records
from hexwire.trace.recording import RecordingWriter

MEGABYTE = 1 << 20


def record(kind: int, content: bytes) -> bytes:
    return bytes((kind,)) + len(content).to_bytes(8, "little") + content


def text(value: str) -> bytes:
    return len(value).to_bytes(4, "little") + value.encode()


def channel(number: int = 1) -> bytes:
    return record(4, struct.pack("<HH", number, 0) + text("/a") + text("json") + bytes(4))


def message(data: bytes, number: int = 1) -> bytes:
    return record(5, struct.pack("<HIQQ", number, 0, 7, 7) + data)


def chunk(
    data: bytes, packed: bytes | None = None, kind: str = "", *, size: int | None = None, crc: int = 0
) -> bytes:
    packed = data if packed is None else packed
    head = struct.pack("<QQQI", 0, 0, len(data) if size is None else size, crc) + text(kind)
    return record(6, head + len(packed).to_bytes(8, "little") + packed)


def read(content: bytes) -> tuple[list[bytes], str]:
    """Data of the messages, and the sentence at the end."""
    found = list(read_records(io.BytesIO(MAGIC + content), "it"))
    remarks = [item for item in found if isinstance(item, str)]
    assert remarks in ([], found[-1:])
    return [item[2].data for item in found if not isinstance(item, str)], "".join(remarks)


FOOTER = record(2, bytes(20))
GOOD = channel() + message(b"{}")


def test_messages_within_and_without_chunks_of_every_kind() -> None:
    inner = channel() + message(b"1")
    for packed in (
        inner,
        chunk(inner, crc=zlib.crc32(inner)),
        chunk(inner, zstandard.compress(inner), "zstd"),
        chunk(inner, lz4.frame.compress(inner), "lz4"),
        record(9, b"attachment" * 9) + inner + record(200, b"of a later version"),
    ):
        assert read(packed + FOOTER) == ([b"1"], "")


@pytest.mark.parametrize(
    ("spoilt", "words"),
    [
        (chunk(GOOD, size=len(GOOD) + 1), "says 65 bytes, but decompresses to less"),
        (chunk(GOOD, zstandard.compress(GOOD), "zstd", size=9), "says 9 bytes, but decompresses to more"),
        (chunk(GOOD, lz4.frame.compress(GOOD), "lz4", size=9), "says 9 bytes, but decompresses to more"),
        (chunk(GOOD, b"junk", "zstd"), "a chunk cannot be decompressed"),
        (chunk(GOOD, b"junk", "lz4"), "says 64 bytes, but decompresses to less"),
        (chunk(GOOD, b"junk" * 9, "lz4"), "a chunk cannot be decompressed"),
        (chunk(GOOD, kind="brotli"), "unknown compression 'brotli'"),
        (chunk(GOOD, crc=5), "the checksum of a chunk is wrong"),
        (chunk(message(b"")[:-1]), "a record in its chunk is longer than the chunk"),
        (chunk(b"\5"), "a record in its chunk is longer than the chunk"),
        (record(6, b"short"), "not a chunk"),
        (record(5, b"short"), "not a message"),
        (record(4, b"short"), "not a channel"),
        (record(3, b"\1\0" + text("\u0416")[:-1] + b"\xff"), "not a schema"),
        (bytes((5,)) + (1 << 40).to_bytes(8, "little"), "its length is 1099511627776 bytes"),
    ],
)
def test_damage_is_reported_with_its_place_after_the_messages_before_it(spoilt: bytes, words: str) -> None:
    begin = len(MAGIC) + len(GOOD)
    data, remark = read(GOOD + spoilt + message(b"behind"))
    assert data == [b"{}"]
    assert remark.startswith(f"the recording is damaged at byte {begin}, record 3: ")
    assert words in remark
    assert remark.endswith("; everything before that is intact")


def test_a_file_cut_at_each_byte_gives_what_is_whole() -> None:
    whole = GOOD + chunk(GOOD, zstandard.compress(GOOD), "zstd") + record(9, b"x") + FOOTER
    for end in range(len(whole)):
        data, remark = read(whole[:end])
        assert len(data) <= 2
        assert remark == "the recording is truncated; everything before that is intact"
    for end in range(len(MAGIC)):
        with pytest.raises(UsageError, match="it is not a recording"):
            list(read_records(io.BytesIO(MAGIC[:end]), "it"))


def zeros(megabytes: int) -> bytes:
    return bytes(megabytes * MEGABYTE)


BIG = message(zeros(16))
BOMBS: dict[str, Callable[[], bytes]] = {
    "zstd, one chunk": lambda: chunk(b"", zstandard.compress(zeros(548)), "zstd", size=548 * MEGABYTE),
    "zstd, size not told": lambda: chunk(b"", zstandard.compress(zeros(548)), "zstd", size=100),
    "zstd, many chunks": lambda: chunk(BIG, zstandard.compress(BIG), "zstd") * 200,
    "lz4, size not told": lambda: chunk(b"", lz4.frame.compress(zeros(200)), "lz4", size=100),
    # Each is within the bound of its size, so that all of them are read, up to one that is damaged.
    "lz4, many chunks": lambda: chunk(BIG, lz4.frame.compress(BIG), "lz4") * 40 + chunk(b"\0" * 10, b"", ""),
    "messages": lambda: chunk(message(zeros(60)), zstandard.compress(message(zeros(60))), "zstd") * 50,
    "channels": lambda: b"".join(
        record(4, struct.pack("<HH", i, 0) + text("x" * MEGABYTE) + text("json") + bytes(4)) for i in range(40)
    ),
}


@pytest.mark.parametrize(
    "name", [name if name == "messages" else pytest.param(name, marks=pytest.mark.slow) for name in BOMBS]
)
def test_a_file_made_to_fill_a_memory_does_not(name: str, tmp_path: Path) -> None:
    path = tmp_path / "bomb.mcap"
    path.write_bytes(MAGIC + BOMBS[name]())
    code = (
        "import sys\nfrom pathlib import Path\nfrom hexwire.trace.mcap_file import read_records\n"
        "with Path(sys.argv[1]).open('rb') as file:\n"
        "    for item in read_records(file, 'it'):\n        last = item\n"
        "print(last)"
    )

    def bounded() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (450 * MEGABYTE, 450 * MEGABYTE))
        resource.setrlimit(resource.RLIMIT_CPU, (60, 60))

    done = subprocess.run(
        [sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=False, preexec_fn=bounded
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("the recording is damaged at byte ")


def test_recordings_of_ours_are_far_from_the_bound(tmp_path: Path) -> None:
    """An arm that stands still for ten minutes packs as well as anything does."""
    with RecordingWriter(tmp_path / "a.mcap") as writer:
        for i in range(12_000):
            writer.joint_state(make_positions(tuple(f"J{j}" for j in range(7)), (0.5,) * 7), 1.7e9 + i / 20)
    with (tmp_path / "a.mcap").open("rb") as file:
        found = list(read_records(file, "it"))
    assert [item for item in found if isinstance(item, str)] == []
    assert len(found) == 12_000


def test_without_the_package_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mcap.records", None)
    with pytest.raises(UsageError, match=r"pip install 'hexwire\[record\]'"):
        load_mcap("mcap.records")

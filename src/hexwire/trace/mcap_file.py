"""The messages of an MCAP file one after the other, in bounded room: chunks are unpacked within limits.

Owns finding records, unpacking chunks, and the sentence that says where a file is cut off or damaged. What is in a
record is read by the package ``mcap``, imported on first use. Must not know topics, nor what messages mean.

A chunk that unpacks to more than 64 MiB, or a file that unpacks to more than 256 times its size, was made to fill a
memory: reading ends there, as it does where a file is cut off or spoilt, and what stands before is given.
"""

from __future__ import annotations

import io
import zlib
from collections.abc import Iterator
from typing import IO, Any

from hexwire.errors import UsageError

__all__ = ["MAGIC", "load_mcap", "read_records"]

MAGIC = b"\x89MCAP0\r\n"

_LARGEST = 64 * 1024 * 1024
"""Bytes of a record or of an unpacked chunk; a file of ours has 64 KiB."""
_MOST_NAMES = 16 * 1024 * 1024
"""Bytes of all schemas and channels, which are kept."""
_BEST_RATIO = 256
"""How many times smaller than its contents a file may be. Ours are 5 to 20 times smaller."""
_WINDOW = 1 << 26
"""Bytes that unpacking may look back."""
_HEAD = 9
_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _FOOTER = 3, 4, 5, 6, 2
_READ = (_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _FOOTER)


class _DamageError(Exception):
    """A record cannot be read; the text says why."""


class _CutError(Exception):
    """The file ends in the middle of a record."""


def read_records(file: IO[bytes], name: str) -> Iterator[tuple[Any, Any, Any] | str]:
    """Schema (or None), channel and message of every message, in the order of the file, as far as it is whole.

    Args:
        file: Open for reading bytes; it need not be seekable.
        name: What to call it in an error.

    Yields:
        Triples of `mcap.records`; at last a sentence if the file is cut off or damaged.

    Raises:
        UsageError: It is no recording, or the package ``mcap`` is not installed.
    """
    load_mcap("mcap.records")
    if file.read(len(MAGIC)) != MAGIC:
        raise UsageError(f"{name} is no recording (MCAP): it does not begin as one")
    reader = _Reader(file)
    try:
        yield from reader.messages()
    except _CutError:
        yield "the recording is cut off; what stands before is whole"
    except _DamageError as error:
        yield (
            f"the recording is damaged at byte {reader.at}, record {reader.number}: {error}; "
            "what stands before is whole"
        )


class _Reader:
    """Where reading is: the byte at which the present record begins, and its number from 1."""

    def __init__(self, file: IO[bytes]) -> None:
        self.at, self.number = 0, 0
        self._file = file
        self._next = len(MAGIC)
        self._unpacked = self._names = 0
        self._schemas: dict[int, Any] = {}
        self._channels: dict[int, Any] = {}

    def messages(self) -> Iterator[tuple[Any, Any, Any]]:
        while True:
            self.at, self.number = self._next, self.number + 1
            head = self._file.read(_HEAD)
            if len(head) < _HEAD:
                raise _CutError
            kind, size = head[0], int.from_bytes(head[1:], "little")
            if kind not in _READ:
                # An index, an attachment: passed over, however long.
                self._skip(size)
                continue
            if size > _LARGEST:
                raise _DamageError(f"its length is {size} bytes")
            content = self._file.read(size)
            if len(content) < size:
                raise _CutError
            self._next += _HEAD + size
            if kind == _FOOTER:
                return
            if kind == _CHUNK:
                yield from self._chunk(content)
            else:
                yield from self._record(kind, content)

    def _skip(self, size: int) -> None:
        left = size
        while left:
            part = self._file.read(min(left, 1 << 20))
            if not part:
                raise _CutError
            left -= len(part)
        self._next += _HEAD + size

    def _chunk(self, content: bytes) -> Iterator[tuple[Any, Any, Any]]:
        chunk = _parsed("Chunk", content)
        data = self._unpack(chunk)
        at = 0
        while at < len(data):
            size = int.from_bytes(data[at + 1 : at + _HEAD], "little")
            if at + _HEAD + size > len(data):
                raise _DamageError("a record in its chunk is longer than the chunk")
            if data[at] in (_SCHEMA, _CHANNEL, _MESSAGE):
                yield from self._record(data[at], data[at + _HEAD : at + _HEAD + size])
            at += _HEAD + size

    def _record(self, kind: int, content: bytes) -> Iterator[tuple[Any, Any, Any]]:
        if kind == _MESSAGE:
            message = _parsed("Message", content, len(content))
            channel = self._channels.get(message.channel_id)
            if channel is not None:
                yield self._schemas.get(channel.schema_id), channel, message
            return
        self._names += len(content)
        if self._names > _MOST_NAMES:
            raise _DamageError(f"its schemas and channels have more than {_MOST_NAMES >> 20} MiB")
        if kind == _SCHEMA:
            schema = _parsed("Schema", content)
            self._schemas[schema.id] = schema
        else:
            channel = _parsed("Channel", content)
            self._channels[channel.id] = channel

    def _unpack(self, chunk: Any) -> bytes:
        """Contents of a chunk. What it says of its size is not believed: no more than that is unpacked."""
        size = chunk.uncompressed_size
        self._unpacked += size
        if size > _LARGEST or self._unpacked > _LARGEST + _BEST_RATIO * self._next:
            raise _DamageError(f"so far {self._next} bytes unpack to {self._unpacked}, which is too much")
        try:
            data = _unpacked(chunk.compression, chunk.data, size)
        except _DamageError:
            raise
        except Exception as error:  # noqa: BLE001  # each library has exceptions of its own
            raise _DamageError(f"a chunk that cannot be unpacked ({' '.join(str(error).split())})") from None
        if len(data) != size:
            wrong = "more" if len(data) > size else "less"
            raise _DamageError(f"a chunk that says {size} bytes unpacks to {wrong}")
        if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
            raise _DamageError("a chunk whose checksum is wrong")
        return data


def _parsed(kind: str, content: bytes, *arguments: int) -> Any:
    stream = load_mcap("mcap.data_stream").ReadDataStream(io.BytesIO(content))
    try:
        return getattr(load_mcap("mcap.records"), kind).read(stream, *arguments)
    except Exception as error:  # noqa: BLE001  # damaged bytes raise whatever mcap's parts raise
        raise _DamageError(f"no {kind.lower()} ({' '.join(str(error).split()) or type(error).__name__})") from None


def _unpacked(compression: str, data: bytes, size: int) -> bytes:
    """At most one byte more than `size`."""
    if compression == "":
        return data
    if compression == "zstd":
        stream = load_mcap("zstandard").ZstdDecompressor(max_window_size=_WINDOW).stream_reader(data)
        found: bytes = stream.read(size + 1)
        return found
    if compression == "lz4":
        frame: bytes = load_mcap("lz4.frame").LZ4FrameDecompressor().decompress(data, max_length=size + 1)
        return frame
    raise _DamageError(f"a chunk packed by {compression[:20]!r}, which is not known")


def load_mcap(module: str) -> Any:
    """A module of the package ``mcap``, or of one that comes with it.

    Raises:
        UsageError: It is not installed; the text says how to.
    """
    from importlib import import_module

    try:
        return import_module(module)
    except ImportError:
        raise UsageError("recordings need the package mcap: pip install 'hexwire[record]'") from None

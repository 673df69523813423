"""Reads the messages of an MCAP file one after the other, in bounded memory, and writes such files.

Owns finding records, decompressing chunks within limits, the sentence that says where a file is truncated or
damaged, and what is left of a file that cannot be written to its end. The package ``mcap``, imported on first use,
reads and writes the contents of a record. Must not know topics.

A chunk that decompresses to more than 64 MiB, or a file that decompresses to more than 256 times its size, is a
decompression bomb: reading ends there, as it does where a file is truncated or damaged; earlier messages are given.
"""

from __future__ import annotations

import io
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any, BinaryIO, Protocol, Self

from hexwire.errors import UsageError
from hexwire.new_file import OutputFile

__all__ = ["MAGIC", "McapIndex", "NewMcapFile", "Readable", "load_mcap", "read_records"]

MAGIC = b"\x89MCAP0\r\n"

_LARGEST = 64 * 1024 * 1024
"""Bytes of a record or of a decompressed chunk; chunks of hexwire have 64 KiB."""
_MOST_NAMES = 16 * 1024 * 1024
"""Bytes of all schemas and channels, which are kept in memory."""
_BEST_RATIO = 256
"""Largest compression ratio of a file. Files of hexwire have 5 to 20."""
_WINDOW = 1 << 26
"""Largest decompression window, bytes."""
# Small chunks, since a crash loses the chunk that is being written.
_CHUNK_SIZE = 64 * 1024
_HEAD = 9
_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _FOOTER = 3, 4, 5, 6, 2
_READ = (_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _FOOTER)


class Readable(Protocol):
    """What is needed of an open file."""

    def read(self, size: int = -1, /) -> bytes: ...


class NewMcapFile:
    """An MCAP file that is written; use it as a context manager, or `close` it.

    Args:
        path: The file. Only its owner can read it.
        profile: Of MCAP.
        force: Overwrite an existing file; it is unchanged until this one is complete.

    Attributes:
        count: Messages written.

    Raises:
        UsageError: The file exists already or cannot be created, or the package ``mcap`` is not installed.
    """

    def __init__(self, path: str | Path, profile: str, *, force: bool) -> None:
        module = load_mcap("mcap.writer")
        self.count = 0
        self._failed: OSError | None = None
        self._closed = False
        self._out = OutputFile(path, force=force, partial=True)
        zstd = module.CompressionType.ZSTD
        self._writer = module.Writer(self._out.file, chunk_size=_CHUNK_SIZE, compression=zstd)
        self._writer.start(profile=profile, library="hexwire")

    @property
    def size(self) -> int:
        """Bytes written so far; a chunk that is being filled is none yet."""
        return int(self._out.file.tell())

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """After an error, refuse all further writing: nothing after a partial chunk could be read."""
        if self._failed is not None:
            raise self._failed
        try:
            yield
        except OSError as error:
            self._failed = error
            raise

    def close(self) -> None:
        """Finish the file. Does nothing if it is finished; after a write error, the file stays truncated.

        Raises:
            OSError: The end of the file cannot be written.
            UsageError: Another program has put a file there meanwhile.
        """
        if self._closed:
            return
        self._closed = True
        try:
            if self._failed is None:
                self._writer.finish()
        finally:
            # Closing writes the buffer, which fails again after a write error.
            with suppress(OSError) if self._failed is not None else nullcontext():
                self._out.keep()

    def discard(self) -> None:
        """Delete the file. Does nothing if it is finished."""
        self._closed = True
        self._out.discard()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        # An error ends the recording; what was recorded before is kept.
        if kind is not None and not self.count:
            self.discard()
        self.close()


class _DamageError(Exception):
    """A record cannot be read; the text says why."""


class _CutError(Exception):
    """The file ends in the middle of a record."""


def read_records(file: Readable, name: str) -> Iterator[tuple[Any, Any, Any] | str]:
    """Schema (or None), channel and message of every message in file order, up to the first damage.

    Args:
        file: Open for reading bytes; it need not be seekable.
        name: Name of the file in errors.

    Yields:
        Triples of `mcap.records`; finally a sentence if the file is truncated or damaged.

    Raises:
        UsageError: It is not a recording, or the package ``mcap`` is not installed.
    """
    load_mcap("mcap.records")
    if file.read(len(MAGIC)) != MAGIC:
        raise UsageError(f"{name} is not a recording (MCAP): it does not start like one")
    reader = _Reader(file)
    try:
        yield from reader.messages()
    except _CutError:
        yield "the recording is truncated; everything before that is intact"
    except _DamageError as error:
        yield (
            f"the recording is damaged at byte {reader.at}, record {reader.number}: {error}; "
            "everything before that is intact"
        )


class McapIndex:
    """The index at the end of a whole MCAP file: which part of it has messages of which channel, and from when.

    Args:
        file: Open for reading bytes.
        name: Its name in errors.

    Attributes:
        channels: Pairs of schema (or None) and channel.

    Raises:
        UsageError: It has none, or a wrong one, or the package ``mcap`` is not installed.
    """

    def __init__(self, file: BinaryIO, name: str) -> None:
        reader = load_mcap("mcap.reader").SeekingReader
        self._name = name
        try:
            self._summary = reader(file, record_size_limit=_LARGEST).get_summary()
        except Exception as error:  # noqa: BLE001  # mcap raises many kinds of errors for damaged bytes
            raise UsageError(f"the index of {name} is damaged: {' '.join(str(error).split())}") from None
        if self._summary is None:
            raise UsageError(f"{name} has no index: recover it with 'hexwire record recover'")
        schemas = self._summary.schemas
        self.channels = [(schemas.get(row.schema_id), row) for row in self._summary.channels.values()]

    def parts(self, topic: str) -> list[tuple[int, int]]:
        """Time of the first message of each part that has messages of a channel, nanoseconds, and its place."""
        numbers = {number for number, row in self._summary.channels.items() if row.topic == topic}
        return [
            (row.message_start_time, row.chunk_start_offset)
            for row in self._summary.chunk_indexes
            if numbers.intersection(row.message_index_offsets)
        ]

    def messages(self, file: BinaryIO, place: int) -> list[tuple[Any, Any]]:
        """Channel and message of every message of a part.

        Raises:
            UsageError: The file is damaged there.
        """
        reader = _Reader(file)
        reader._channels, reader._schemas = self._summary.channels, self._summary.schemas
        file.seek(place)
        head = file.read(_HEAD)
        size = int.from_bytes(head[1:], "little")
        content = file.read(size) if len(head) == _HEAD and head[0] == _CHUNK and size <= _LARGEST else b""
        try:
            if not content or len(content) < size:
                raise _DamageError("there is no part of it")
            return [(channel, message) for _, channel, message in reader._chunk(content)]
        except _DamageError as error:
            raise UsageError(f"{self._name} is damaged at byte {place}: {error}") from None


class _Reader:
    """Reads records. `at` is the byte at which the current record starts, `number` counts records from 1."""

    def __init__(self, file: Readable) -> None:
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
                # Skip an index or an attachment of any length.
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
            raise _DamageError(f"its schemas and channels are larger than {_MOST_NAMES >> 20} MiB")
        if kind == _SCHEMA:
            schema = _parsed("Schema", content)
            self._schemas[schema.id] = schema
        else:
            channel = _parsed("Channel", content)
            self._channels[channel.id] = channel

    def _unpack(self, chunk: Any) -> bytes:
        """Decompress a chunk, but no more than the size it claims."""
        size = chunk.uncompressed_size
        self._unpacked += size
        if size > _LARGEST or self._unpacked > _LARGEST + _BEST_RATIO * self._next:
            raise _DamageError(f"so far {self._next} bytes decompress to {self._unpacked}, which is too much")
        try:
            data = _unpacked(chunk.compression, chunk.data, size)
        except _DamageError:
            raise
        except Exception as error:  # noqa: BLE001  # each library has its own exceptions
            raise _DamageError(f"a chunk cannot be decompressed ({' '.join(str(error).split())})") from None
        if len(data) != size:
            wrong = "more" if len(data) > size else "less"
            raise _DamageError(f"a chunk says {size} bytes, but decompresses to {wrong}")
        if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
            raise _DamageError("the checksum of a chunk is wrong")
        return data


def _parsed(kind: str, content: bytes, *arguments: int) -> Any:
    stream = load_mcap("mcap.data_stream").ReadDataStream(io.BytesIO(content))
    try:
        return getattr(load_mcap("mcap.records"), kind).read(stream, *arguments)
    except Exception as error:  # noqa: BLE001  # mcap raises many kinds of errors for damaged bytes
        raise _DamageError(
            f"not a {kind.lower()} ({' '.join(str(error).split()) or type(error).__name__})"
        ) from None


def _unpacked(compression: str, data: bytes, size: int) -> bytes:
    """Decompress at most one byte more than `size`."""
    if compression == "":
        return data
    if compression == "zstd":
        stream = load_mcap("zstandard").ZstdDecompressor(max_window_size=_WINDOW).stream_reader(data)
        found: bytes = stream.read(size + 1)
        return found
    if compression == "lz4":
        frame: bytes = load_mcap("lz4.frame").LZ4FrameDecompressor().decompress(data, max_length=size + 1)
        return frame
    raise _DamageError(f"a chunk has the unknown compression {compression[:20]!r}")


def load_mcap(module: str) -> Any:
    """A module of the package ``mcap``, or of one that comes with it.

    Raises:
        UsageError: It is not installed; the text says how to install it.
    """
    from importlib import import_module

    try:
        return import_module(module)
    except ImportError:
        raise UsageError("recordings need the package mcap: pip install 'hexwire[record]'") from None

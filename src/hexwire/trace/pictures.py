"""The pictures of a recording by their time, without reading what is before them.

Owns finding a picture in the file's own index, within the bounds of `mcap_file`. Must not know cameras or pages.
"""

from __future__ import annotations

import binascii
from bisect import bisect_right
from typing import TYPE_CHECKING, Any, BinaryIO

from hexwire.errors import UsageError
from hexwire.inputs import parse_message

from .mcap_file import McapIndex

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["RecordedPictures", "is_picture"]

_BACK = 4
"""Parts of the file in which a picture is looked for: the last one that has begun may have a later one only."""
_NAME = "foxglove.CompressedImage"


def is_picture(schema: Any, channel: Any) -> bool:
    """Whether a schema and channel of `mcap_file.read_records` are those of pictures."""
    return schema is not None and schema.name == _NAME and channel.message_encoding == "json"


class RecordedPictures:
    """Where the pictures of a recording are.

    Args:
        file: The recording, open for reading bytes; it must be whole.
        name: Its name in errors.

    Raises:
        UsageError: It has no index, or a wrong one, or the package ``mcap`` is not installed.
    """

    def __init__(self, file: BinaryIO, name: str) -> None:
        self._name = name
        self._index = McapIndex(file, name)
        self._parts: dict[str, tuple[list[int], list[int]]] = {}
        for topic in {channel.topic for schema, channel in self._index.channels if is_picture(schema, channel)}:
            parts = sorted(self._index.parts(topic))
            self._parts[topic] = [start for start, _ in parts], [offset for _, offset in parts]

    def at(self, file: BinaryIO, topic: str, ns: int) -> bytes:
        """The JPEG that was newest at a time; the first one before there was any.

        Args:
            file: The recording.
            topic: Of its camera.
            ns: Nanoseconds since 1970.

        Raises:
            UsageError: There is none, or the file is damaged there.
            ConfigError: It is no picture; the text says where.
        """
        starts, offsets = self._parts.get(topic, ([], []))
        last = bisect_right(starts, ns)
        for offset in reversed(offsets[max(0, last - _BACK) : last]):
            found = [message for message in self._messages(file, offset, topic) if message.log_time <= ns]
            if found:
                return self._jpeg(max(found, key=lambda message: message.log_time).data)
        for offset in offsets[:1]:
            for message in self._messages(file, offset, topic):
                return self._jpeg(message.data)
        raise UsageError(f"{self._name} has no picture on {topic} at this time")

    def _messages(self, file: BinaryIO, offset: int, topic: str) -> Iterator[Any]:
        return (message for channel, message in self._index.messages(file, offset) if channel.topic == topic)

    def _jpeg(self, data: bytes) -> bytes:
        picture = parse_message(data, self._name, "a picture").table(("data",))["data"]
        text = picture.text(1 << 20)
        try:
            return binascii.a2b_base64(text, strict_mode=True)
        except ValueError:
            raise picture.fault("must be base64") from None

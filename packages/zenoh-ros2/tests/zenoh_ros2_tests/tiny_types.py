"""Two types with a codec of their own, for tests of the wire that do not depend on `zenoh_ros2.types`."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import Any

from zenoh_ros2.errors import LocalProtocolError, RemoteProtocolError

_HEAD = b"\x00\x01\x00\x00"
HASH = "RIHS01_" + "ab" * 32


@dataclass
class Text:
    data: str = ""


@dataclass
class TextType:
    name: str = "std_msgs/msg/String"
    dds_name: str = "std_msgs::msg::dds_::String_"
    hash: str = HASH

    def __call__(self, data: str = "") -> Text:
        return Text(data)

    def serialize(self, message: Text) -> bytes:
        if not isinstance(message.data, str):
            raise LocalProtocolError("data is not text")
        text = message.data.encode() + b"\0"
        return _HEAD + struct.pack("<I", len(text)) + text

    def parse(self, data: bytes) -> Text:
        if len(data) < 9 or data[:4] != _HEAD or struct.unpack_from("<I", data, 4)[0] != len(data) - 8:
            raise RemoteProtocolError("not a String")
        try:
            return Text(data[8:-1].decode())
        except UnicodeDecodeError:
            raise RemoteProtocolError("not text") from None


@dataclass
class EchoType:
    name: str = "tiny_msgs/srv/Echo"
    dds_name: str = "tiny_msgs::srv::dds_::Echo_"
    hash: str = HASH
    request: TextType = field(default_factory=TextType)
    response: TextType = field(default_factory=TextType)


class TinyTypes:
    def message(self, name: str) -> Any:
        assert name == "std_msgs/msg/String"
        return TextType()

    def service(self, name: str) -> Any:
        assert name == "tiny_msgs/srv/Echo"
        return EchoType()

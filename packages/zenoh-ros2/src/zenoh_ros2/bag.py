"""Bags of ROS 2: a folder with an MCAP file in ROS 2's profile, and the ``metadata.yaml`` that `ros2 bag` reads.

Owns what is in both files. Schemas are ``ros2msg``, messages are CDR, so Foxglove and PlotJuggler open the MCAP
file alone. Must not know what is recorded. Needs the package ``mcap``, imported on first use.

    arm/                the bag: `ros2 bag play arm`
    arm/arm_0.mcap      its messages
    arm/metadata.yaml   written when the bag is complete; `ros2 bag reindex` makes it for one that is not
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from .distributions import NO_TYPE_HASH
from .qos import DEFAULT, Qos
from .types import MessageType, Types

if TYPE_CHECKING:
    from types import TracebackType

__all__ = ["METADATA", "PROFILE", "BagMessages", "BagWriter", "mcap_name"]

METADATA = "metadata.yaml"
PROFILE = "ros2"
"""Of the MCAP file."""
_VERSION = 8
"""Version of ``metadata.yaml``, with policies as numbers: Humble reads it, and all that came after."""


def mcap_name(folder: Path) -> str:
    """Name of the MCAP file in a bag."""
    return f"{folder.name}_0.mcap"


@dataclass(slots=True)
class _Topic:
    type: MessageType
    qos: Qos
    channel: int
    count: int = 0


class BagMessages:
    """The messages of a bag, through a writer of the package ``mcap``, whose file is the caller's.

    Args:
        writer: An `mcap.writer.Writer` that was started with `PROFILE`; the caller finishes it.
        file: Name of its file in the bag.
        types: The distribution's; its name is stored.

    Attributes:
        count: Messages written.
    """

    def __init__(self, writer: Any, file: str, types: Types) -> None:
        self._writer, self._file, self._types = writer, file, types
        self._topics: dict[str, _Topic] = {}
        self._first, self._last = 2**63 - 1, 0
        self.count = 0

    def write(self, topic: str, message_type: str, message: Any, stamp: int, qos: Qos = DEFAULT) -> None:
        """Write a message.

        Args:
            topic: Its topic, with the slash; created on first use.
            message_type: Full name of its type, as in ``sensor_msgs/msg/JointState``.
            message: The message.
            stamp: Nanoseconds since 1970.
            qos: What its publisher offers: `ros2 bag play` offers the same.

        Raises:
            LocalProtocolError: The message has an unsuitable value.
            OSError: It cannot be written; nor can anything after it.
            UsageError: There is no such type.
        """
        found = self._topics.get(topic)
        if found is None:
            found = self._topics[topic] = self._new_topic(topic, message_type, qos)
        data = found.type.serialize(message)
        self._writer.add_message(found.channel, stamp, data, stamp, found.count & 0xFFFFFFFF)
        found.count += 1
        self.count += 1
        self._first, self._last = min(self._first, stamp), max(self._last, stamp)

    def _new_topic(self, topic: str, message_type: str, qos: Qos) -> _Topic:
        type_ = self._types.message(message_type)
        schema = self._writer.register_schema(type_.name, "ros2msg", type_.text.encode())
        metadata = {"offered_qos_profiles": _qos_text(qos), "topic_type_hash": _hash_of(type_)}
        return _Topic(type_, qos, self._writer.register_channel(topic, "cdr", schema, metadata))

    def metadata(self) -> str:
        """The text of ``metadata.yaml``, once all is written."""
        first, duration = (self._first, self._last - self._first) if self.count else (0, 0)
        times = [f"nanoseconds_since_epoch: {first}", f"nanoseconds: {duration}"]
        # JSON is YAML, too: it quotes what needs it.
        lines = [
            "rosbag2_bagfile_information:",
            f"  version: {_VERSION}",
            "  storage_identifier: mcap",
            "  duration:",
            f"    {times[1]}",
            "  starting_time:",
            f"    {times[0]}",
            f"  message_count: {self.count}",
            "  topics_with_message_count:" + ("" if self._topics else " []"),
        ]
        for name, topic in self._topics.items():
            lines += [
                "    - topic_metadata:",
                f"        name: {json.dumps(name)}",
                f"        type: {topic.type.name}",
                "        serialization_format: cdr",
                f"        offered_qos_profiles: {json.dumps(_qos_text(topic.qos))}",
                f"        type_description_hash: {json.dumps(_hash_of(topic.type))}",
                f"      message_count: {topic.count}",
            ]
        lines += [
            '  compression_format: ""',
            '  compression_mode: ""',
            "  relative_file_paths:",
            f"    - {json.dumps(self._file)}",
            "  files:",
            f"    - path: {json.dumps(self._file)}",
            "      starting_time:",
            f"        {times[0]}",
            "      duration:",
            f"        {times[1]}",
            f"      message_count: {self.count}",
            "  custom_data: ~",
            f"  ros_distro: {self._types.distribution.value}",
        ]
        return "\n".join([*lines, ""])


class BagWriter:
    """Writes a bag; use it as a context manager, or `close` it.

    Args:
        folder: The bag, which must not exist.
        types: The distribution's; its name is stored.

    Raises:
        ImportError: The package ``mcap`` is not installed: ``pip install 'zenoh-ros2[bags]'``.
        OSError: The folder exists, or cannot be created.
    """

    def __init__(self, folder: str | Path, types: Types) -> None:
        from mcap.writer import Writer

        self.folder = Path(folder)
        self.folder.mkdir()
        self._out = (self.folder / mcap_name(self.folder)).open("xb")
        self._writer: Any = Writer(self._out)
        self._writer.start(profile=PROFILE, library="zenoh-ros2")
        self._messages = BagMessages(self._writer, mcap_name(self.folder), types)

    @property
    def count(self) -> int:
        """Messages written."""
        return self._messages.count

    def write(self, topic: str, message_type: str, message: Any, stamp: int, qos: Qos = DEFAULT) -> None:
        """Write a message; see `BagMessages.write`."""
        self._messages.write(topic, message_type, message, stamp, qos)

    def close(self) -> None:
        """Finish the bag. Does nothing if it is finished.

        Raises:
            OSError: The end cannot be written.
        """
        if self._out.closed:
            return
        with self._out:
            self._writer.finish()
        (self.folder / METADATA).write_text(self._messages.metadata(), encoding="utf-8")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _hash_of(type_: MessageType) -> str:
    return "" if type_.hash == NO_TYPE_HASH else type_.hash


def _qos_text(qos: Qos) -> str:
    """A list with one quality of service, as `ros2 bag` has it up to version 8."""

    def duration(name: str, value: tuple[int, int]) -> list[str]:
        return [f"  {name}:", f"    sec: {value[0]}", f"    nsec: {value[1]}"]

    return "\n".join(
        [
            f"- history: {int(qos.history)}",
            f"  depth: {qos.depth}",
            f"  reliability: {int(qos.reliability)}",
            f"  durability: {int(qos.durability)}",
            *duration("deadline", qos.deadline),
            *duration("lifespan", qos.lifespan),
            f"  liveliness: {int(qos.liveliness)}",
            *duration("liveliness_lease_duration", qos.lease),
            "  avoid_ros_namespace_conventions: false",
        ]
    )

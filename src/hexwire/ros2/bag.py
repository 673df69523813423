"""Bags of ROS 2: a folder with an MCAP file in ROS 2's profile, and the ``metadata.yaml`` that `ros2 bag` reads.

Owns both files. Schemas are ``ros2msg``, messages are CDR, so Foxglove and PlotJuggler open the MCAP file alone.
Must not know what is recorded. Needs the package ``mcap``, imported on first use.

    arm/                the bag: `ros2 bag play arm`
    arm/arm_0.mcap      its messages
    arm/metadata.yaml   written when the bag is complete; `ros2 bag reindex` makes it for one that is not
"""

from __future__ import annotations

import json
import stat
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hexwire.errors import UsageError
from hexwire.new_file import OutputFile
from hexwire.trace.mcap_file import NewMcapFile, load_mcap
from zenoh_ros2.distributions import NO_TYPE_HASH
from zenoh_ros2.qos import DEFAULT, Qos

if TYPE_CHECKING:
    from zenoh_ros2.types import MessageType, Types

__all__ = ["BagWriter"]

METADATA = "metadata.yaml"
_VERSION = 8
"""Version of ``metadata.yaml``, with policies as numbers: Humble reads it, and all that came after."""


@dataclass(slots=True)
class _Topic:
    type: MessageType
    qos: Qos
    channel: int
    count: int = 0


class BagWriter(NewMcapFile):
    """Writes a bag; use it as a context manager, or `close` it.

    Args:
        folder: The bag. Only its owner can read the files in it.
        types: The distribution's; its name is stored.
        force: Overwrite an existing bag of this name.

    Attributes:
        folder: The bag.
        count: Messages written.

    Raises:
        UsageError: The folder exists already or cannot be created, or the package ``mcap`` is not installed.
    """

    def __init__(self, folder: str | Path, types: Types, *, force: bool = False) -> None:
        load_mcap("mcap.writer")
        self.folder = Path(folder)
        self._types = types
        self._force = force
        self._file = f"{self.folder.name}_0.mcap"
        self._made = _make_folder(self.folder, {self._file, METADATA}, force)
        try:
            super().__init__(self.folder / self._file, "ros2", force=force)
        except UsageError:
            self._remove_folder()
            raise
        self._topics: dict[str, _Topic] = {}
        self._first, self._last = 2**63 - 1, 0

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
        """
        with self._writing():
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

    def close(self) -> None:
        """Finish the bag. Does nothing if it is finished; after a write error, its MCAP file stays truncated.

        Raises:
            OSError: The end cannot be written.
            UsageError: Another program has put a file there meanwhile.
        """
        if self._closed:
            return
        super().close()
        if self._failed is None:
            with OutputFile(self.folder / METADATA, force=self._force) as out:
                out.file.write(self._metadata().encode())

    def discard(self) -> None:
        """Delete the bag. Does nothing if it is finished."""
        if not self._closed:
            super().discard()
            self._remove_folder()

    def _remove_folder(self) -> None:
        if self._made:
            with suppress(OSError):
                self.folder.rmdir()

    def _metadata(self) -> str:
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


def _make_folder(folder: Path, files: set[str], force: bool) -> bool:
    """Make the folder of a bag; return whether it is new."""
    if folder.name in ("", ".."):
        raise UsageError(f"{folder} has no name; name a new folder")
    try:
        folder.mkdir()
    except FileExistsError:
        if not stat.S_ISDIR(folder.lstat().st_mode):
            raise UsageError(f"{folder} is not a folder; choose another name") from None
        if not force:
            raise UsageError(f"{folder} already exists; --force overwrites it") from None
        if others := sorted({path.name for path in folder.iterdir()} - files):
            raise UsageError(f"{folder} is not overwritten: it also has {others[0]}") from None
        return False
    except OSError as error:
        raise UsageError(f"{folder} cannot be created: {error.strerror}; choose another place") from None
    return True


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

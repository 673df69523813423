"""Messages under the names of Foxglove's schemas, as plain values that become JSON, and their JSON schemas.

Owns what a joint state, a line of a log, a picture, and the shapes of an arm are as such messages, in recordings
and live. The schemas allow additional fields, which hold what Foxglove has no name for (load, current, voltage,
temperature, flags). Must not know files.

Source: https://docs.foxglove.dev/docs/sdk/schemas
"""

from __future__ import annotations

import math
from base64 import b64encode
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from hexwire.errors import UsageError
from hexwire.model.palette import joint_colour
from hexwire.model.pose import Matrix, Vector, quaternion, rotation_from_rpy
from hexwire.model.shapes import COLOURS, ArmShapes, Shape

if TYPE_CHECKING:
    from hexwire.model.state import JointState

__all__ = [
    "END_OF_TIME",
    "INFO",
    "NSEC",
    "SCHEMAS",
    "WARNING",
    "compressed_image",
    "frame_transforms",
    "joint_states",
    "log_line",
    "nanoseconds",
    "picture_topic",
    "positions",
    "scene_update",
    "time_of",
]

NSEC = 1_000_000_000
"""Nanoseconds in a second."""
INFO, WARNING = 2, 3
"""Levels of a log; others are 1 debug, 4 error, 5 fatal."""
END_OF_TIME = 2**63 / NSEC
"""Seconds since 1970 at which signed 64-bit nanoseconds overflow: in 2262."""

_TIME = {
    "type": "object",
    "title": "time",
    "properties": {
        "sec": {"type": "integer", "minimum": 0},
        "nsec": {"type": "integer", "minimum": 0, "maximum": NSEC - 1},
    },
}
_NUMBER = {"type": "number"}
SCHEMAS: dict[str, dict[str, Any]] = {
    "foxglove.JointStates": {
        "title": "foxglove.JointStates",
        "description": "The states of a robot's joints",
        "type": "object",
        "properties": {
            "timestamp": _TIME,
            "joints": {
                "type": "array",
                "items": {
                    "type": "object",
                    "title": "foxglove.JointState",
                    "properties": {
                        "name": {"type": "string"},
                        "position": {**_NUMBER, "description": "radians"},
                        "goal": {**_NUMBER, "description": "last position sent, radians"},
                        "velocity": {**_NUMBER, "description": "radians per second"},
                        "load": {**_NUMBER, "description": "signed fraction of full drive"},
                        "current": {**_NUMBER, "description": "amperes"},
                        "voltage": {**_NUMBER, "description": "volts"},
                        "temperature": {**_NUMBER, "description": "degrees Celsius"},
                        "age": {**_NUMBER, "description": "seconds from the joint's sample to the timestamp"},
                        "flags": {"type": "integer", "description": "condition, as hexwire.model.state.JointFlag"},
                    },
                },
            },
        },
    },
}
SCHEMAS["foxglove.Log"] = {
    "title": "foxglove.Log",
    "description": "A line of a log; a frame on the line, explained",
    "type": "object",
    "properties": {
        "timestamp": _TIME,
        "level": {"type": "integer", "description": "1 debug, 2 info, 3 warning, 4 error, 5 fatal"},
        "message": {"type": "string"},
        "name": {"type": "string", "description": "who wrote it; of a frame, sent or received"},
        "file": {"type": "string"},
        "line": {"type": "integer"},
        "hex": {"type": "string", "description": "the bytes"},
    },
}
SCHEMAS["hexwire.Clock"] = {
    "title": "hexwire.Clock",
    "description": "The clock of an arm's server, compared with the recorder's",
    "type": "object",
    "properties": {
        "timestamp": _TIME,
        "offset": {**_NUMBER, "description": "seconds: server's monotonic clock minus recorder's wall clock"},
        "uncertainty": {**_NUMBER, "description": "seconds: the offset is right to this"},
        "round_trip": {**_NUMBER, "description": "seconds: of this exchange"},
        "jumps": {"type": "integer", "description": "times that the server's clock jumped"},
    },
}


def _object(title: str, **fields: dict[str, Any]) -> dict[str, Any]:
    return {"title": f"foxglove.{title}", "type": "object", "properties": fields}


def _rows(of: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": of}


_TEXT, _DURATION = {"type": "string"}, {**_TIME, "title": "duration"}
_VECTOR = _object("Vector3", x=_NUMBER, y=_NUMBER, z=_NUMBER)
_QUATERNION = _object("Quaternion", x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
_POSE = _object("Pose", position=_VECTOR, orientation=_QUATERNION)
_COLOUR = _object("Color", r=_NUMBER, g=_NUMBER, b=_NUMBER, a=_NUMBER)
_SOLID = {"pose": _POSE, "size": _VECTOR, "color": _COLOUR}
_UNUSED: dict[str, Any] = {
    name: _rows(_object(title))
    for name, title in (
        ("arrows", "ArrowPrimitive"),
        ("lines", "LinePrimitive"),
        ("triangles", "TriangleListPrimitive"),
        ("texts", "TextPrimitive"),
        ("models", "ModelPrimitive"),
    )
}
"""Fields that a scene must have; an arm has nothing for them."""
SCHEMAS["foxglove.CompressedImage"] = _object(
    "CompressedImage",
    timestamp=_TIME,
    frame_id=_TEXT,
    data={"type": "string", "contentEncoding": "base64"},
    format=_TEXT,
)
SCHEMAS["foxglove.FrameTransforms"] = _object(
    "FrameTransforms",
    transforms=_rows(
        _object(
            "FrameTransform",
            timestamp=_TIME,
            parent_frame_id=_TEXT,
            child_frame_id=_TEXT,
            translation=_VECTOR,
            rotation=_QUATERNION,
        )
    ),
)
SCHEMAS["foxglove.SceneUpdate"] = _object(
    "SceneUpdate",
    deletions=_rows(_object("SceneEntityDeletion", timestamp=_TIME, type={"type": "integer"}, id=_TEXT)),
    entities=_rows(
        _object(
            "SceneEntity",
            timestamp=_TIME,
            frame_id=_TEXT,
            id=_TEXT,
            lifetime=_DURATION,
            frame_locked={"type": "boolean"},
            metadata=_rows(_object("KeyValuePair", key=_TEXT, value=_TEXT)),
            cubes=_rows(_object("CubePrimitive", **_SOLID)),
            spheres=_rows(_object("SpherePrimitive", **_SOLID)),
            cylinders=_rows(_object("CylinderPrimitive", **_SOLID, bottom_scale=_NUMBER, top_scale=_NUMBER)),
            **_UNUSED,
        )
    ),
)
"""JSON schemas by name."""


def nanoseconds(stamp: float) -> int:
    """Nanoseconds since 1970, the unit of time of a message.

    Raises:
        UsageError: It is before 1970, not a number, or later than a recording can store.
    """
    if not 0 <= stamp < END_OF_TIME:
        raise UsageError(f"a recording cannot store the time {stamp:g} s; use seconds since 1970")
    return round(stamp * NSEC)


def time_of(stamp: float) -> dict[str, int]:
    """The time of a message; raises as `nanoseconds`."""
    ns = nanoseconds(stamp)
    return {"sec": ns // NSEC, "nsec": ns % NSEC}


def joint_states(state: JointState, stamp: float, goals: Mapping[str, float] | None = None) -> dict[str, Any]:
    """A joint state as ``foxglove.JointStates``; unknown values (NaN) are omitted.

    Args:
        state: The state.
        stamp: Its time, seconds since 1970.
        goals: Positions that were sent last, by joint, radians.
    """
    joints = []
    for i, name in enumerate(state.names):
        joint: dict[str, Any] = {"name": name}
        for key, column in (
            ("position", state.position),
            ("velocity", state.velocity),
            ("load", state.load),
            ("current", state.current),
            ("voltage", state.voltage),
            ("temperature", state.temperature),
        ):
            if math.isfinite(column[i]):
                joint[key] = column[i]
        if goals is not None and math.isfinite(goal := goals.get(name, math.nan)):
            joint["goal"] = goal
        if 0.0 < state.age[i] < math.inf:
            joint["age"] = state.age[i]
        joint["flags"] = int(state.flags[i])
        joints.append(joint)
    return {"timestamp": time_of(stamp), "joints": joints}


def positions(found: Mapping[str, float], stamp: float) -> dict[str, Any]:
    """Positions alone, by joint in radians, as ``foxglove.JointStates``; `stamp` in seconds since 1970."""
    joints = [{"name": name, "position": position} for name, position in found.items() if math.isfinite(position)]
    return {"timestamp": time_of(stamp), "joints": joints}


def log_line(level: int, text: str, name: str, stamp: float, file: str = "", line: int = 0) -> dict[str, Any]:
    """A line of a log as ``foxglove.Log``.

    Args:
        level: 1 debug, 2 info, 3 warning, 4 error, 5 fatal.
        text: The line.
        name: Who wrote it.
        stamp: Seconds since 1970.
        file: Of the program.
        line: In that file.
    """
    return {
        "timestamp": time_of(stamp),
        "level": level,
        "message": text,
        "name": name,
        "file": file,
        "line": line,
    }


def picture_topic(camera: str) -> str:
    """Topic of the pictures of a camera of this name."""
    return f"/camera/{camera}"


def compressed_image(jpeg: bytes, camera: str, stamp: float) -> dict[str, Any]:
    """A picture as ``foxglove.CompressedImage``.

    Args:
        jpeg: A whole JPEG.
        camera: Name of its camera, which is that of its frame, too.
        stamp: When it was taken, seconds since 1970.
    """
    data = b64encode(jpeg).decode("ascii")
    return {"timestamp": time_of(stamp), "frame_id": camera, "data": data, "format": "jpeg"}


def frame_transforms(
    shapes: ArmShapes, found: Mapping[str, float], stamp: float, prefix: str = ""
) -> dict[str, Any]:
    """Where the links of an arm are, as ``foxglove.FrameTransforms``; all are given in the frame of the first.

    Args:
        shapes: The arm.
        found: Joint positions of the driver, radians; 0 for a joint that is not in it.
        stamp: Seconds since 1970.
        prefix: Before the name of each frame, so that frames of two arms differ.
    """
    time, base = time_of(stamp), shapes.links[0].name
    rows = [
        {
            "timestamp": time,
            "parent_frame_id": prefix + base,
            "child_frame_id": prefix + name,
            "translation": _vector(pose.position),
            "rotation": _turn(pose.rotation),
        }
        for name, pose in shapes.poses(found).items()
        if name != base
    ]
    return {"transforms": rows}


def scene_update(shapes: ArmShapes, names: Iterable[str], stamp: float, prefix: str = "") -> dict[str, Any]:
    """What an arm looks like, as ``foxglove.SceneUpdate``: one entity a link, which stays and follows its frame.

    Args:
        shapes: The arm.
        names: Its joints, in the order of their colours.
        stamp: Seconds since 1970.
        prefix: As for `frame_transforms`.
    """
    time = time_of(stamp)
    order = {name: i for i, name in enumerate(names)}
    entities = []
    for link in shapes.links:
        solids: dict[str, list[dict[str, Any]]] = {"box": [], "sphere": [], "cylinder": []}
        for shape in link.shapes:
            solids[shape.kind].append(_solid(shape, order))
        if link.shapes:
            entities.append(
                {
                    "timestamp": time,
                    "frame_id": prefix + link.name,
                    "id": prefix + link.name,
                    "lifetime": {"sec": 0, "nsec": 0},
                    "frame_locked": True,
                    "metadata": [],
                    "cubes": solids["box"],
                    "spheres": solids["sphere"],
                    "cylinders": solids["cylinder"],
                    **{name: [] for name in _UNUSED},
                }
            )
    return {"deletions": [], "entities": entities}


def _solid(shape: Shape, order: Mapping[str, int]) -> dict[str, Any]:
    size = shape.size
    lengths: Vector
    if shape.kind == "box":
        lengths = (size[0], size[1], size[2])
    elif shape.kind == "cylinder":
        lengths = (2 * size[0], 2 * size[0], size[1])
    else:
        lengths = (2 * size[0],) * 3
    colour = joint_colour(order.get(shape.joint, 0)) if shape.colour == "joint" else COLOURS[shape.colour][0]
    red, green, blue = (int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5))
    row = {
        "pose": {"position": _vector(shape.place), "orientation": _turn(rotation_from_rpy(*shape.rpy))},
        "size": _vector(lengths),
        "color": {"r": red, "g": green, "b": blue, "a": 1.0},
    }
    return row | {"bottom_scale": 1.0, "top_scale": 1.0} if shape.kind == "cylinder" else row


def _vector(found: Vector) -> dict[str, float]:
    return dict(zip("xyz", found, strict=True))


def _turn(rotation: Matrix) -> dict[str, float]:
    return dict(zip("xyzw", quaternion(rotation), strict=True))

"""Reads requests from standard input, a JSON value a line, and answers each with a line; runs with Jazzy's rclpy.

{type, data}   parse the message `data` (hexadecimal) of a type, and serialize it again: {data} or {error}
"""

from __future__ import annotations

import importlib
import json
import sys
from typing import Any

from rclpy.serialization import deserialize_message, serialize_message


def class_of(name: str) -> Any:
    """The class of a message; that of a request or response is inside that of its service."""
    package, kind, stem = name.split("/")
    module = importlib.import_module(f"{package}.{kind}")
    if kind == "msg":
        return getattr(module, stem)
    outer, _, part = stem.rpartition("_")
    return getattr(getattr(module, outer), part)


for line in sys.stdin:
    asked = json.loads(line)
    try:
        message = deserialize_message(bytes.fromhex(asked["data"]), class_of(asked["type"]))
        answer = {"data": bytes(serialize_message(message)).hex()}
    except Exception as error:  # noqa: BLE001  # the test fails with it
        answer = {"error": repr(error)}
    sys.stdout.write(json.dumps(answer) + "\n")
    sys.stdout.flush()

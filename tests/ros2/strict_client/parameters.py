"""A parameter client: the six services of rcl_interfaces below a node's name, as `ros2 param` uses them."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from tests.ros2.strict_client.wire import PARAMETERS, Participant

NOT_SET, BOOL, INTEGER, DOUBLE, STRING, BYTES, BOOLS, INTEGERS, DOUBLES, STRINGS = range(10)
_FIELDS = [
    None, "bool_value", "integer_value", "double_value", "string_value", "byte_array_value",
    "bool_array_value", "integer_array_value", "double_array_value", "string_array_value",
]  # fmt: skip


def value(made: Any) -> dict[str, Any]:
    """A ParameterValue of a Python value; None is NOT_SET."""
    if made is None:
        return {"type": NOT_SET}
    if isinstance(made, list):
        kind = BOOLS + [bool, int, float, str].index(type(made[0]))
    elif isinstance(made, bytes):
        kind = BYTES
    else:
        kind = BOOL + [bool, int, float, str].index(type(made))
    return {"type": kind, _FIELDS[kind] or "": made}


def plain(read: SimpleNamespace) -> Any:
    """The Python value of a ParameterValue, whose other fields must be empty."""
    for kind, field in enumerate(_FIELDS):
        if field is not None and kind != read.type:
            other = getattr(read, field)
            assert other in (False, 0, 0.0, "", b"", []), f"{field} is {other} in a value of type {read.type}"
    return None if read.type == NOT_SET else getattr(read, _FIELDS[read.type] or "")


def parameter(name: str, made: Any) -> dict[str, Any]:
    return {"name": name, "value": value(made)}


class ParameterClient:
    def __init__(self, participant: Participant, node: str) -> None:
        def client(leaf: str, kind: str) -> Any:
            return participant.client(f"{node}/{leaf}", f"rcl_interfaces/srv/{kind}", PARAMETERS)

        self._get = client("get_parameters", "GetParameters")
        self._types = client("get_parameter_types", "GetParameterTypes")
        self._set = client("set_parameters", "SetParameters")
        self._atomically = client("set_parameters_atomically", "SetParametersAtomically")
        self._describe = client("describe_parameters", "DescribeParameters")
        self._list = client("list_parameters", "ListParameters")

    def list(self, prefixes: list[str] | None = None, depth: int = 0) -> SimpleNamespace:
        result: SimpleNamespace = self._list.call(prefixes=prefixes or [], depth=depth).result
        return result

    def get_all(self, names: list[str]) -> list[Any]:
        return [plain(read) for read in self._get.call(names=names).values]

    def get(self, name: str) -> Any:
        (read,) = self.get_all([name])
        return read

    def types(self, names: list[str]) -> list[int]:
        return [int(kind) for kind in self._types.call(names=names).types]

    def set_all(self, made: dict[str, Any]) -> list[SimpleNamespace]:
        results = self._set.call(parameters=[parameter(*item) for item in made.items()]).results
        assert len(results) == len(made), "one result for each parameter"
        return list(results)

    def set(self, name: str, made: Any) -> SimpleNamespace:
        (result,) = self.set_all({name: made})
        return result

    def set_atomically(self, made: dict[str, Any]) -> SimpleNamespace:
        result: SimpleNamespace = self._atomically.call(
            parameters=[parameter(*item) for item in made.items()]
        ).result
        return result

    def describe(self, names: list[str]) -> list[SimpleNamespace]:
        return list(self._describe.call(names=names).descriptors)

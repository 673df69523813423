"""The parameter server of a node: declared parameters, their services, and the topic of changes.

Owns the rules of `rclcpp`: static types, ranges, read-only parameters, all or nothing, what a list of names is; and
the words of its refusals, which programs may look for. Must not know what a parameter is for: whoever declares it
checks its values and says why one is refused.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Any

from . import type_descriptions
from .distributions import Distribution
from .errors import UsageError
from .qos import PARAMETER_EVENTS, PARAMETERS
from .times import time_fields

if TYPE_CHECKING:
    from .node import Node
    from .types import Types

__all__ = ["Descriptor", "ParameterServer", "ParameterType", "Value", "type_of"]

Value = bool | int | float | str | bytes | Sequence[bool] | Sequence[int] | Sequence[float] | Sequence[str]

_MOST_NAMES = 10_000
"""Most names in one request; more are garbage."""
_ULP = 100.0
"""Doubles that differ by so many units in the last place count as equal, as in `rclcpp`."""
_EPSILON = 2.0**-52


class ParameterType(IntEnum):
    """Types of parameters, with the numbers of rcl_interfaces/msg/ParameterType."""

    NOT_SET = 0
    BOOL = 1
    INTEGER = 2
    DOUBLE = 3
    STRING = 4
    BYTE_ARRAY = 5
    BOOL_ARRAY = 6
    INTEGER_ARRAY = 7
    DOUBLE_ARRAY = 8
    STRING_ARRAY = 9

    @property
    def words(self) -> str:
        """As `rclcpp` says it."""
        return self.name.lower()


_FIELDS = {
    ParameterType.BOOL: "bool_value",
    ParameterType.INTEGER: "integer_value",
    ParameterType.DOUBLE: "double_value",
    ParameterType.STRING: "string_value",
    ParameterType.BYTE_ARRAY: "byte_array_value",
    ParameterType.BOOL_ARRAY: "bool_array_value",
    ParameterType.INTEGER_ARRAY: "integer_array_value",
    ParameterType.DOUBLE_ARRAY: "double_array_value",
    ParameterType.STRING_ARRAY: "string_array_value",
}
_RANGES = {ParameterType.INTEGER: "integer", ParameterType.DOUBLE: "floating point"}
_ARRAYS = {
    ParameterType.BOOL: ParameterType.BOOL_ARRAY,
    ParameterType.INTEGER: ParameterType.INTEGER_ARRAY,
    ParameterType.DOUBLE: ParameterType.DOUBLE_ARRAY,
    ParameterType.STRING: ParameterType.STRING_ARRAY,
}


def type_of(value: Value) -> ParameterType:
    """The type of a value; an empty list is one of texts.

    Raises:
        TypeError: No parameter has such a value.
    """
    if isinstance(value, bool):
        return ParameterType.BOOL
    if isinstance(value, int):
        return ParameterType.INTEGER
    if isinstance(value, float):
        return ParameterType.DOUBLE
    if isinstance(value, str):
        return ParameterType.STRING
    if isinstance(value, bytes):
        return ParameterType.BYTE_ARRAY
    if isinstance(value, Sequence):
        kinds = {type_of(item) for item in value}
        if not kinds:
            return ParameterType.STRING_ARRAY
        if len(kinds) == 1 and (only := kinds.pop()) in _ARRAYS:
            return _ARRAYS[only]
    raise TypeError(f"{value!r} is no value of a parameter")


@dataclass(frozen=True, slots=True)
class Descriptor:
    """What is said of a parameter.

    Attributes:
        description: What it is for.
        constraints: Rules for its value that no range can say.
        read_only: It does not change while the node runs.
        low: Least number, if there is a range.
        high: Greatest number; likewise.
    """

    description: str = ""
    constraints: str = ""
    read_only: bool = False
    low: float = -math.inf
    high: float = math.inf

    @property
    def ranged(self) -> bool:
        """It has a range with both ends."""
        return math.isfinite(self.low) and math.isfinite(self.high)


@dataclass(slots=True)
class _Parameter:
    type: ParameterType
    value: Value
    descriptor: Descriptor


class ParameterServer:
    """The parameters of a node. Declare all of them, then `offer` them; any thread may then call `set`.

    ``start_type_description_service``, which every node of ROS has since type hashes, is declared already.

    Args:
        node: The node; must be open when the parameters are offered.
        types: Its types.
        on_set: Gets new values by name, before they are stored: it refuses them with an error whose text is the
            reason, or takes them, all together. Called in one thread at a time; must not wait long.
        ros_time: Returns the ROS time, nanoseconds.
        refused_by: The errors of `on_set` that refuse.
    """

    def __init__(
        self,
        node: Node,
        types: Types,
        *,
        on_set: Callable[[Mapping[str, Value]], object] = lambda changes: None,
        ros_time: Callable[[], int] = time.time_ns,
        refused_by: type[Exception] = ValueError,
    ) -> None:
        self._node, self._on_set, self._ros_time, self._refused_by = node, on_set, ros_time, refused_by
        message = types.message
        self._value_message = message("rcl_interfaces/msg/ParameterValue")
        self._parameter_message = message("rcl_interfaces/msg/Parameter")
        self._descriptor_message = message("rcl_interfaces/msg/ParameterDescriptor")
        self._double_range = message("rcl_interfaces/msg/FloatingPointRange")
        self._integer_range = message("rcl_interfaces/msg/IntegerRange")
        self._event = message("rcl_interfaces/msg/ParameterEvent")
        self._time = message("builtin_interfaces/msg/Time")
        self._list_result = message("rcl_interfaces/msg/ListParametersResult")
        self._set_result = message("rcl_interfaces/msg/SetParametersResult")
        self._responses = {
            name: types.service(f"rcl_interfaces/srv/{kind}").response
            for name, (kind, _) in self._services().items()
        }
        # Since callbacks may change what is asked for, which came after Humble.
        self._refuses_none = types.distribution is not Distribution.HUMBLE
        self._lock = threading.RLock()
        self._parameters: dict[str, _Parameter] = {}
        self._events: Any = None
        if types.distribution.has_type_hashes:
            # What the node does, whatever was asked for.
            told = node.options.type_descriptions
            self.declare(type_descriptions.PARAMETER, told, Descriptor("describe types to others", read_only=True))

    def declare(self, name: str, value: Value, descriptor: Descriptor | None = None) -> None:
        """Declare a parameter; its type is that of the value.

        Args:
            name: Its name, with dots between its parts.
            value: Its present value, which is not checked.
            descriptor: What is said of it.

        Raises:
            ValueError: It is declared already.
        """
        with self._lock:
            if name in self._parameters:
                raise ValueError(f"the parameter {name} is declared already")
            self._parameters[name] = _Parameter(type_of(value), value, descriptor or Descriptor())

    def offer(self) -> None:
        """Offer the services, and tell others of all parameters."""
        self._events = self._node.publisher(
            "/parameter_events", "rcl_interfaces/msg/ParameterEvent", PARAMETER_EVENTS
        )
        for name, (kind, callback) in self._services().items():
            self._node.service(f"~/{name}", f"rcl_interfaces/srv/{kind}", callback, PARAMETERS)
        with self._lock:
            self._publish(new=sorted(self._parameters))

    def values(self) -> dict[str, Value]:
        """All values by name."""
        with self._lock:
            return {name: parameter.value for name, parameter in self._parameters.items()}

    def set(self, changes: Mapping[str, Value]) -> None:
        """Change parameters: all of them, or none.

        Args:
            changes: New values by name.

        Raises:
            UsageError: A parameter is not declared, read-only, of another type, or out of its range.
        """
        with self._lock:
            if not changes and self._refuses_none:
                raise UsageError("parameter list cannot be empty: there is no parameter to set")
            for name, value in changes.items():
                self._check(name, value)
            if not changes:
                return
            self._on_set(changes)
            for name, value in changes.items():
                self._parameters[name].value = value
            self._publish(changed=changes)

    def _check(self, name: str, value: Value) -> None:
        parameter = self._parameters.get(name)
        if parameter is None:
            raise UsageError(
                f"parameter '{name:.200}' cannot be set because it was not declared; `ros2 param list` shows those "
                "of this node"
            )
        if parameter.descriptor.read_only:
            raise UsageError(
                f"parameter '{name}' cannot be set because it is read-only: it is read when the node starts; "
                "restart it with the new value"
            )
        kind = type_of(value)
        empty = kind is ParameterType.STRING_ARRAY and not value
        if kind is not parameter.type and not (empty and parameter.type in _ARRAYS.values()):
            hint = ""
            if isinstance(value, int) and (kind, parameter.type) == (ParameterType.INTEGER, ParameterType.DOUBLE):
                hint = f" Write {value}.0"
            raise UsageError(
                f"Wrong parameter type, parameter {{{name}}} is of type {{{parameter.type.words}}}, setting it to "
                f"{{{kind.words}}} is not allowed.{hint}"
            )
        row = parameter.descriptor
        if row.ranged and isinstance(value, int | float) and not _within(float(value), row.low, row.high):
            raise UsageError(
                f"Parameter {{{name}}} doesn't comply with {_RANGES[parameter.type]} range. {value:g} must be "
                f"{row.low:g} to {row.high:g}"
            )

    # -- services -------------------------------------------------------------------------------------------------

    def _services(self) -> dict[str, tuple[str, Callable[[Any], Any]]]:
        return {
            "get_parameters": ("GetParameters", self._get),
            "get_parameter_types": ("GetParameterTypes", self._get_types),
            "set_parameters": ("SetParameters", self._set_each),
            "set_parameters_atomically": ("SetParametersAtomically", self._set_all),
            "describe_parameters": ("DescribeParameters", self._describe),
            "list_parameters": ("ListParameters", self._list),
        }

    def _rows(self, names: Iterable[str]) -> list[tuple[str, _Parameter]]:
        """Parameters by name; none at all if one of them is not declared, as in `rclcpp`."""
        with self._lock:
            names = list(names)[:_MOST_NAMES]
            if not all(name in self._parameters for name in names):
                return []
            return [(name, self._parameters[name]) for name in names]

    def _get(self, request: Any) -> Any:
        values = [self._message_of(row.type, row.value) for _, row in self._rows(request.names)]
        return self._responses["get_parameters"](values=values)

    def _get_types(self, request: Any) -> Any:
        types = bytes(row.type for _, row in self._rows(request.names))
        return self._responses["get_parameter_types"](types=types)

    def _describe(self, request: Any) -> Any:
        rows = [self._describe_one(name, row) for name, row in self._rows(request.names)]
        return self._responses["describe_parameters"](descriptors=rows)

    def _describe_one(self, name: str, row: _Parameter) -> Any:
        said = row.descriptor
        described = self._descriptor_message(
            name=name,
            type=int(row.type),
            description=said.description,
            additional_constraints=said.constraints,
            read_only=said.read_only,
        )
        if said.ranged and row.type is ParameterType.DOUBLE:
            described.floating_point_range = [self._double_range(from_value=said.low, to_value=said.high)]
        if said.ranged and row.type is ParameterType.INTEGER:
            limits = self._integer_range(from_value=int(said.low), to_value=int(said.high), step=1)
            described.integer_range = [limits]
        return described

    def _list(self, request: Any) -> Any:
        prefixes, depth = list(request.prefixes)[:_MOST_NAMES], int(request.depth)
        with self._lock:
            names = [name for name in sorted(self._parameters) if _is_listed(name, prefixes, depth)]
        above = [name.rpartition(".")[0] for name in names if "." in name]
        result = self._list_result(names=names, prefixes=list(dict.fromkeys(above)))
        return self._responses["list_parameters"](result=result)

    def _set_each(self, request: Any) -> Any:
        results = [self._set_some([row]) for row in request.parameters]
        return self._responses["set_parameters"](results=results)

    def _set_all(self, request: Any) -> Any:
        return self._responses["set_parameters_atomically"](result=self._set_some(request.parameters))

    def _set_some(self, rows: Iterable[Any]) -> Any:
        try:
            self.set({row.name: _value_of(row.name, row.value) for row in rows})
        except (UsageError, self._refused_by) as error:
            return self._set_result(successful=False, reason=str(error))
        return self._set_result(successful=True)

    # -- messages -------------------------------------------------------------------------------------------------

    def _publish(self, new: Iterable[str] = (), changed: Iterable[str] = ()) -> None:
        if self._events is None:
            return
        self._events.publish(
            self._event(
                stamp=self._time(**time_fields(self._ros_time())),
                node=self._node.full_name,
                new_parameters=[self._parameter(name) for name in new],
                changed_parameters=[self._parameter(name) for name in changed],
            )
        )

    def _parameter(self, name: str) -> Any:
        row = self._parameters[name]
        return self._parameter_message(name=name, value=self._message_of(row.type, row.value))

    def _message_of(self, kind: ParameterType, value: Value) -> Any:
        return self._value_message(type=int(kind), **{_FIELDS[kind]: value})


def _value_of(name: str, message: Any) -> Value:
    try:
        field = _FIELDS[ParameterType(message.type)]
    except (KeyError, ValueError):
        if message.type == ParameterType.NOT_SET:
            raise UsageError(f"cannot undeclare a statically typed parameter: {name!r:.200}") from None
        raise UsageError(
            f"{name!r:.200} has no type {message.type}; see rcl_interfaces/msg/ParameterType"
        ) from None
    value: Value = getattr(message, field)
    return value


def _within(value: float, low: float, high: float) -> bool:
    return low <= value <= high or _equal(value, low) or _equal(value, high)


def _equal(x: float, y: float) -> bool:
    return abs(x - y) <= _EPSILON * abs(x + y) * _ULP


def _is_listed(name: str, prefixes: Sequence[str], depth: int) -> bool:
    """Whether a list with these prefixes and this depth contains a name; 0 means any depth."""
    if not prefixes:
        return not depth or name.count(".") < depth
    for prefix in prefixes:
        if name == prefix:
            return True
        if name.startswith(f"{prefix}.") and (not depth or name.count(".", len(prefix) + 1) < depth):
            return True
    return False

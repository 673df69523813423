"""Stands in for ROS's launch modules: remembers what a launch file asks for, and says what it would start."""

from __future__ import annotations

import sys
import types
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

_NAMES = {
    "launch": ("LaunchDescription",),
    "launch.actions": (
        "DeclareLaunchArgument",
        "ExecuteProcess",
        "IncludeLaunchDescription",
        "RegisterEventHandler",
        "SetEnvironmentVariable",
    ),
    "launch.conditions": ("IfCondition", "UnlessCondition"),
    "launch.event_handlers": ("OnProcessExit",),
    "launch.launch_description_sources": ("PythonLaunchDescriptionSource",),
    "launch.substitutions": ("LaunchConfiguration",),
    "launch_ros": (),
    "launch_ros.actions": ("Node",),
    "ament_index_python": (),
    "ament_index_python.packages": (),
    "moveit_configs_utils": (),
}


@dataclass
class Thing:
    """Anything that a launch file makes: its class, and the arguments."""

    kind: str
    args: tuple[Any, ...]
    options: dict[str, Any]

    def __getitem__(self, name: str) -> Any:
        return self.options[name]


@dataclass
class MoveIt:
    """Stands in for MoveItConfigsBuilder: reads the files that it is told to read."""

    share: Path
    files: dict[str, Path] = field(default_factory=dict)
    options: dict[str, dict[str, Any]] = field(default_factory=dict)

    def __getattr__(self, name: str) -> Any:
        def call(**options: Any) -> MoveIt:
            self.options[name] = options
            if "file_path" in options:
                self.files[name] = self.share / options["file_path"]
                assert self.files[name].is_file(), f"{name}: {self.files[name]}"
            return self

        return call

    def to_moveit_configs(self) -> Any:
        return types.SimpleNamespace(
            to_dict=lambda: {"from": dict(self.files)},
            robot_description={"robot_description": self.files["robot_description"].read_text(encoding="utf-8")},
            robot_description_semantic={},
            robot_description_kinematics={},
            planning_pipelines={},
            joint_limits={},
        )


@contextmanager
def stand_ins(share: Path, package: str) -> Iterator[list[MoveIt]]:
    """Stand-ins in place of the modules; the package's files are in `share`."""
    built: list[MoveIt] = []

    def builder(robot: str, *, package_name: str) -> MoveIt:
        assert package_name == package
        built.append(MoveIt(share))
        return built[-1]

    def directory(name: str) -> str:
        assert name == package
        return str(share)

    modules = {name: types.ModuleType(name) for name in _NAMES}
    for name, kinds in _NAMES.items():
        for kind in kinds:
            setattr(modules[name], kind, _maker(kind))
    modules["ament_index_python.packages"].get_package_share_directory = directory  # type: ignore[attr-defined]
    modules["moveit_configs_utils"].MoveItConfigsBuilder = builder  # type: ignore[attr-defined]
    before = {name: sys.modules.get(name) for name in modules}
    sys.modules.update(modules)
    try:
        yield built
    finally:
        for name, module in before.items():
            if module is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module


def _maker(kind: str) -> Any:
    return lambda *args, **options: Thing(kind, args, options)


def described(path: Path) -> list[Thing]:
    """The things that a launch file describes, those of event handlers too."""
    names: dict[str, Any] = {"__file__": str(path), "__name__": path.stem}
    exec(compile(path.read_text(encoding="utf-8"), str(path), "exec"), names)
    (found,) = names["generate_launch_description"]().args
    things: list[Thing] = list(found)
    for thing in found:
        if thing.kind == "RegisterEventHandler":
            things += thing.args[0]["on_exit"]
    return things


def holds(condition: Thing | None, values: Mapping[str, str]) -> bool:
    """Whether a condition of a launch file is true with these arguments."""
    if condition is None:
        return True
    value = values[condition.args[0].args[0]] == "true"
    return value if condition.kind == "IfCondition" else not value


def text(word: Any, values: Mapping[str, str]) -> str:
    """A word of a command line, with the arguments in their places."""
    parts = word if isinstance(word, list) else [word]
    return "".join(part if isinstance(part, str) else values[part.args[0]] for part in parts)

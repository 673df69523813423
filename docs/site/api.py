"""The reference of the Python interface: which modules are in it, and what they are about.

Owns that list. The text of each page is the module's docstrings, which mkdocstrings reads without importing them.
"""

from __future__ import annotations

import ast
from pathlib import Path

__all__ = ["MODULES", "pages"]

FOLDER = "reference/api"
_PAGE = """\
---
title: {title}
---

# {module}

::: {module}
    options:
      show_root_heading: false
      show_root_toc_entry: false
"""
MODULES: dict[str, tuple[str, ...]] = {
    "An arm in a person's hands": (
        "hexwire.arm.verbs",
        "hexwire.arm.handle",
        "hexwire.arm.blocks",
        "hexwire.arm.poses",
        "hexwire.control.motion.motion_result",
        "hexwire.control.motion.rest",
        "hexwire.control.motion.via",
        "hexwire.model.aim",
        "hexwire.model.picture",
        "hexwire.motion.teach",
        "hexwire.units",
    ),
    "Robots": (
        "hexwire.drivers.registry",
        "hexwire.drivers.base",
        "hexwire.drivers.abilities",
        "hexwire.drivers.plain",
        "hexwire.drivers.hex7bot",
        "hexwire.drivers.bus_arm",
        "hexwire.drivers.puma260",
        "hexwire.drivers.timed_path",
        "hexwire.drivers.arm_file",
        "hexwire.drivers.session_driver",
        "hexwire.drivers.replies",
        "hexwire.drivers.robot_state",
    ),
    "Arms, states and kinematics": (
        "hexwire.model.state",
        "hexwire.model.arm",
        "hexwire.model.pose",
        "hexwire.model.calibration",
        "hexwire.model.geometry",
        "hexwire.model.gripper",
        "hexwire.model.aim",
        "hexwire.model.arms",
        "hexwire.model.arms.so_arm",
        "hexwire.model.arms.hex7bot.joints",
        "hexwire.model.arms.hex7bot.kinematics",
        "hexwire.model.arms.puma260.kinematics",
        "hexwire.model.arms.so_arm.kinematics",
        "hexwire.model.arms.so_arm.links",
    ),
    "Motions": (
        "hexwire.control.motion.motions",
        "hexwire.control.loop.owner",
        "hexwire.control.motion.path_check",
        "hexwire.setup.calibrating",
        "hexwire.setup.hand_calibration",
        "hexwire.setup.auto_calibration",
        "hexwire.control.motion.operator_control",
        "hexwire.motion.limits",
        "hexwire.motion.trajectory",
        "hexwire.motion.through",
        "hexwire.motion.checks",
        "hexwire.motion.following",
        "hexwire.motion.teach",
    ),
    "Servos on an adapter": (
        "hexwire.bus.servo_bus",
        "hexwire.bus.values",
        "hexwire.bus.setup",
        "hexwire.wire.registers",
    ),
    "Sessions and links": (
        "hexwire.ipc.session",
        "hexwire.ipc.handle",
        "hexwire.ipc.conf",
        "hexwire.session.connection",
        "hexwire.session.events",
        "hexwire.link.open",
        "hexwire.link.base",
        "hexwire.link.url",
        "hexwire.link.memory",
        "hexwire.link.impair",
        "hexwire.link.listener",
    ),
    "Bytes": (
        "hexwire.wire.command_frame",
        "hexwire.wire.commands",
        "hexwire.wire.modules",
        "hexwire.wire.addresses",
        "hexwire.wire.robot_bodies",
        "hexwire.wire.servo_packet",
    ),
    "Emulated arms": (
        "hexwire.emulator.board",
        "hexwire.emulator.bus_device",
        "hexwire.emulator.serve",
        "hexwire.emulator.bus_arms",
        "hexwire.emulator.hand",
        "hexwire.emulator.serve_hand",
    ),
    "Tests for links and robots": ("hexwire.testing.link", "hexwire.testing.robot"),
    "Files and errors": ("hexwire.new_file", "hexwire.errors"),
    "ROS": ("hexwire.ros1.path", "hexwire.ros1.messages", "hexwire.ros2"),
}
"""Subject -> modules. What the pages of ``docs/`` import is here; the rest is hexwire's own affair."""


def pages(source: Path) -> dict[str, str]:
    """Page of the site -> its text.

    Args:
        source: The folder that contains the package.
    """
    made = {}
    lines = [
        "# Python",
        "",
        "All units are SI: angles in radians, times in seconds, torques in newton metres. A name that no page here",
        "shows may change in any release.",
        "",
        "## hexwire",
        "",
        "These names are in the package itself: `import hexwire`.",
        "",
        "| name | defined in |",
        "|---|---|",
    ]
    lines += [
        f"| [`hexwire.{name}`]({module}.md#{module}.{name}) | `{module}` |" for name, module in _public(source)
    ]
    lines.append("| [`hexwire.HexwireError`](hexwire.errors.md#hexwire.errors.HexwireError) | `hexwire.errors` |")
    for subject, modules in MODULES.items():
        lines += ["", f"## {subject}", "", "| module | owns |", "|---|---|"]
        for module in modules:
            lines.append(f"| [`{module}`]({module}.md) | {_first_line(source, module)} |")
            made[f"{FOLDER}/{module}.md"] = _PAGE.format(module=module, title=module.removeprefix("hexwire."))
    return {f"{FOLDER}/index.md": "\n".join([*lines, ""]), **made}


def _public(source: Path) -> list[tuple[str, str]]:
    """The package's own names, and the module of each."""
    tree = ast.parse((source / "hexwire" / "__init__.py").read_text(encoding="utf-8"))
    for node in tree.body:
        if isinstance(node, ast.AnnAssign) and ast.unparse(node.target) == "_LAZY" and node.value is not None:
            return sorted(ast.literal_eval(node.value).items())
    raise LookupError("hexwire/__init__.py has no table of its names")


def _first_line(source: Path, module: str) -> str:
    path = source / module.replace(".", "/")
    path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return " ".join(text.partition("\n\n")[0].split()).replace("|", "\\|").replace("``", "`")

"""Writes control_msgs and osrf_msgs as Python packages, for programs that do not import hexwire.

Owns the files. Their fields and checksums come from `messages`; genpy generates their code, as for any ROS package.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from hexwire.errors import HexwireError, UsageError

from .messages import PACKAGES, PARTS, SERVICES, definition
from .path import ROS_MISSING

__all__ = ["write_messages"]


def write_messages(folder: Path) -> tuple[Path, ...]:
    """Write the packages.

    Args:
        folder: Where to write them; created if missing. With this folder on PYTHONPATH, they can be imported.

    Returns:
        The folders of the packages.

    Raises:
        UsageError: A package exists already, or ROS is not installed or not found (`hexwire.ros1.path.find_ros`).
        HexwireError: A file cannot be written.
    """
    packages = [folder / package for package in PACKAGES]
    for path in packages:
        if path.exists() or path.is_symlink():
            raise UsageError(f"{path} exists; remove it first, or name another folder")
    files = {folder / name: "\n".join(lines) + "\n" for name, lines in _generate()}
    try:
        for path in {path.parent for path in files}:
            path.mkdir(parents=True, exist_ok=True)
        for path, text in files.items():
            with path.open("x", encoding="utf-8") as file:
                file.write(text)
    except OSError as error:
        raise HexwireError(f"cannot write {error.filename}: {error.strerror}") from None
    return tuple(packages)


def _generate() -> Iterator[tuple[str, Iterable[str]]]:
    """Yield the path (relative to the folder) and the lines of each file."""
    try:
        genmsg: Any = importlib.import_module("genmsg")
        generator: Any = importlib.import_module("genpy.generator")
        definitions = {part: definition(part) for part in PARTS}
    except ImportError as error:
        raise UsageError(f"{ROS_MISSING} ({error})") from None
    context = genmsg.MsgContext.create_default()
    loader = genmsg.msg_loader
    for package, messages in PACKAGES.items():
        definitions |= {f"{package}/{name}": fields for name, (_, fields) in messages.items()}
    specs = {name: loader.load_msg_from_string(context, fields, name) for name, fields in definitions.items()}
    for name, spec in specs.items():
        context.register(name, spec)
    for package, messages in PACKAGES.items():
        yield f"{package}/__init__.py", ()
        yield f"{package}/msg/__init__.py", [f"from ._{name} import *" for name in messages]
        for name in messages:
            yield f"{package}/msg/_{name}.py", generator.msg_generator(context, specs[f"{package}/{name}"], {})
        services = SERVICES.get(package, {})
        if services:
            yield f"{package}/srv/__init__.py", [f"from ._{name} import *" for name in services]
        for name, (_, request, response) in services.items():
            text = f"{request}---\n{response}"
            spec = loader.load_srv_from_string(context, text, f"{package}/{name}")
            yield f"{package}/srv/_{name}.py", generator.srv_generator(context, spec, {})

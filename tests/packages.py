"""Packages of others, put where the interpreter finds them, as pip does.

Owns nothing but the files; whoever wants the folder on the path prepends it.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from hexwire import extras

__all__ = ["install"]


def install(folder: Path, name: str, entries: Mapping[str, Mapping[str, str]], files: Mapping[str, str]) -> None:
    """Put a package into a folder.

    Args:
        folder: On the interpreter's path.
        name: Of the distribution.
        entries: Entry points: group -> name -> what it names.
        files: Path -> text.
    """
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    groups = [
        f"[{group}]\n" + "".join(f"{key} = {value}\n" for key, value in points.items())
        for group, points in entries.items()
    ]
    (info / "entry_points.txt").write_text("\n".join(groups))
    for path, text in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(text)
    # They may have been looked for before.
    extras._installed.cache_clear()

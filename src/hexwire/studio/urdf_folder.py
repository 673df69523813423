"""The folder of a robot's URDF: what pages draw of it, and the meshes that they may load.

Owns which files of the folder are read, once and within bounds, before anything is open. Nothing outside the folder
is read, whatever its URDF says. `geometry` makes the values for the 3D view. Must not know pages.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hexwire.errors import ConfigError, UsageError
from hexwire.inputs import read_bytes, read_text
from hexwire.model.urdf_robot import parse_urdf

from .geometry import make_urdf_geometry
from .mesh_files import LARGEST_FILE, Mesh, read_mesh

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel

__all__ = ["UrdfFolder"]

_LARGEST_URDF = 1 << 20
_MOST_MESHES, _LARGEST_ALL, _MOST_TRIANGLES = 64, 64 << 20, 500_000
"""Files, and bytes and triangles of all of them."""


class UrdfFolder:
    """A robot as its URDF describes it.

    Args:
        path: A folder with one URDF in it, or in its folder ``urdf``; or such a file.

    Attributes:
        meshes: What pages may load, by number.
        faults: Why a mesh is not shown, in words.

    Raises:
        UsageError: There is no URDF, or several, or it is damaged.
    """

    def __init__(self, path: str | Path) -> None:
        found = Path(path)
        try:
            files = [found] if found.suffix.lower() == ".urdf" else sorted(found.glob("*.urdf"))
            files = files or sorted(found.glob("urdf/*.urdf"))
            # Without links: one that leads to itself ends here.
            real = [file.resolve() for file in files[:1]]
        except (OSError, RuntimeError, ValueError) as error:
            raise UsageError(f"{str(found)[:200]!r} cannot be looked at: {str(error)[:200]}") from None
        if len(files) != 1:
            names = ", ".join(file.name for file in files[:5])
            raise UsageError(f"{found} has {len(files)} URDF files{names and f': {names}; name one of them'}")
        (file,) = files
        self._folder = (found.parent if files == [found] else found).resolve()
        (self._file,) = real
        self.robot = parse_urdf(read_text(file, largest=_LARGEST_URDF), str(file))
        self.meshes: list[Mesh] = []
        self.faults: list[str] = []
        self._numbers: dict[str, int | None] = {}
        for link in self.robot.links:
            for visual in link.visuals:
                if visual.kind == "mesh" and visual.file not in self._numbers:
                    self._numbers[visual.file] = self._load(visual.file)

    def geometry(self, arm: ArmModel) -> dict[str, Any] | None:
        """What the 3D view draws for an arm, as `make_geometry`; None if no joint has a name of the arm's."""
        if not {joint.name for joint in self.robot.joints} & set(arm.names):
            return None
        kinds = {file: (n, self.meshes[n].kind) for file, n in self._numbers.items() if n is not None}
        return make_urdf_geometry(self.robot, arm, kinds) | {"faults": self.faults}

    def _load(self, address: str) -> int | None:
        """Read a mesh; its number, or None for one that is not shown."""
        try:
            made = self._read(address)
            if sum(mesh.triangles for mesh in self.meshes) + made.triangles > _MOST_TRIANGLES:
                raise ConfigError(f"has one triangle too many: a robot has at most {_MOST_TRIANGLES}")
            if sum(len(mesh.body) for mesh in self.meshes) + len(made.body) > _LARGEST_ALL:
                raise ConfigError(f"is too much: the meshes of a robot have at most {_LARGEST_ALL >> 20} MiB")
        except ConfigError as error:
            # A terminal would obey what is not printable.
            name = "".join(each if each.isprintable() else "?" for each in address.rpartition("/")[2][:60])
            self.faults.append(f"{name} {str(error).removeprefix(f'{error.file}: ')}")
            return None
        self.meshes.append(made)
        return len(self.meshes) - 1

    def _read(self, address: str) -> Mesh:
        if len(self._numbers) >= _MOST_MESHES:
            raise ConfigError(f"is one file too many: a robot has at most {_MOST_MESHES}")
        file = self._find(address)
        return read_mesh(read_bytes(file, largest=LARGEST_FILE), file.suffix)

    def _find(self, address: str) -> Path:
        """The file of an address, which is in the folder."""
        package = re.match(r"(?:package|model)://([^/]+)/(.+)", address)
        if package is not None:
            # The folder of the package is this one, or in this one.
            places = [self._folder / package[2], self._folder / package[1] / package[2]]
        elif "://" in address:
            raise ConfigError("is at an address; only files of the folder are shown")
        else:
            places = [self._file.parent / address]
        outside = False
        for place in places:
            try:
                # Without links, so that none leads out of the folder.
                real = place.resolve(strict=True)
            except (OSError, RuntimeError, ValueError):
                continue
            if real.is_relative_to(self._folder):
                return real
            outside = True
        raise ConfigError("is outside the folder" if outside else "is not there")

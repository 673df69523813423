"""What a URDF file says of the looks of a robot: its links with their solids and meshes, and its joints.

Owns the format and its bounds: a file may come from anybody. Reads text, not files; what a mesh is, others know.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal
from xml.etree import ElementTree

from hexwire.errors import ConfigError

from .pose import Vector
from .shapes import Drive

__all__ = ["UrdfJoint", "UrdfLink", "UrdfRobot", "UrdfVisual", "parse_urdf"]

_MOST_LINKS, _MOST_VISUALS = 256, 1024
_LONGEST = 400
"""Letters of a name or of a mesh's address."""
_FARTHEST = 100.0
"""Metres; anything beyond is in a wrong unit."""
_GREY = "#b0b7c0"
_ZERO: Vector = (0.0, 0.0, 0.0)
_MOVES = ("revolute", "continuous", "prismatic")


@dataclass(frozen=True, slots=True)
class UrdfVisual:
    """A solid or a mesh of a link.

    Attributes:
        kind: Form; a cylinder's axis is its z axis.
        size: Metres along x, y, z of a box; radius and length of a cylinder; radius of a ball. A mesh: its scale.
        place: Its origin in the frame of the link, metres.
        rpy: Its turn there, radians.
        colour: As ``#rrggbb``.
        file: Address of a mesh, as written.
    """

    kind: Literal["box", "cylinder", "sphere", "mesh"]
    size: tuple[float, ...]
    place: Vector = _ZERO
    rpy: Vector = _ZERO
    colour: str = _GREY
    file: str = ""


@dataclass(frozen=True, slots=True)
class UrdfLink:
    """A link: its name and what is seen of it."""

    name: str
    visuals: tuple[UrdfVisual, ...] = ()


@dataclass(frozen=True, slots=True)
class UrdfJoint:
    """A joint.

    Attributes:
        name: Its name.
        parent: Link that carries it.
        child: Link that it moves.
        place: Place of the child's frame in the parent's, metres.
        rpy: Its turn there, radians.
        axis: In the child's frame, of length 1; None for a joint that does not move.
        slides: It moves along the axis, not about it.
        drive: What moves it: itself, or another joint; the offset of one that slides is in metres.
    """

    name: str
    parent: str
    child: str
    place: Vector
    rpy: Vector
    axis: Vector | None
    slides: bool
    drive: Drive


@dataclass(frozen=True, slots=True)
class UrdfRobot:
    """A robot. Its links are in an order in which each comes after the one that carries it."""

    name: str
    links: tuple[UrdfLink, ...]
    joints: tuple[UrdfJoint, ...]


def parse_urdf(text: str, file: str = "") -> UrdfRobot:
    """Read a URDF text.

    Args:
        text: Of the file.
        file: Its name, for errors.

    Raises:
        ConfigError: It is not a URDF of one tree of links, or beyond the bounds.
    """
    # Entities could make a small file huge, and no URDF needs them.
    if re.search(r"<!\s*(DOCTYPE|ENTITY)", text, re.IGNORECASE):
        raise ConfigError("a URDF has no DOCTYPE", file=file)
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        line, column = error.position
        raise ConfigError("is no XML", file=file, line=line, column=column + 1) from None
    reader = _UrdfReader(file)
    if root.tag != "robot":
        raise reader.fault("has no <robot>; a xacro file must be expanded first")
    materials = {name: colour for each in root.findall("material") for name, colour in reader.material(each)}
    links = [reader.link(each, materials) for each in root.findall("link")]
    joints = [reader.joint(each) for each in root.findall("joint")]
    if not 0 < len(links) <= _MOST_LINKS or len(joints) >= _MOST_LINKS:
        raise reader.fault(f"has {len(links)} links and {len(joints)} joints; at most {_MOST_LINKS} links")
    if sum(len(link.visuals) for link in links) > _MOST_VISUALS:
        raise reader.fault(f"has more than {_MOST_VISUALS} visuals")
    return UrdfRobot(root.get("name", "")[:_LONGEST], tuple(reader.tree(links, joints)), tuple(joints))


class _UrdfReader:
    def __init__(self, file: str) -> None:
        self._file = file

    def fault(self, words: str) -> ConfigError:
        return ConfigError(words, file=self._file)

    def text(self, element: ElementTree.Element | None, key: str) -> str:
        found = None if element is None else element.get(key)
        if found is None or not 0 < len(found) <= _LONGEST:
            raise self.fault(f"something has no {key}, or one of more than {_LONGEST} letters")
        return found

    def numbers(self, words: str, count: int, most: float = _FARTHEST) -> tuple[float, ...]:
        parts = words.split(maxsplit=count)
        try:
            found = tuple(map(float, parts))
        except ValueError:
            found = ()
        if len(found) != count or not all(abs(each) <= most for each in found):
            raise self.fault(f"{words[:60]!r} is not {count} numbers of at most {most:g}")
        return found

    def vector(self, element: ElementTree.Element | None, key: str, usual: Vector = _ZERO) -> Vector:
        if element is None or element.get(key) is None:
            return usual
        a, b, c = self.numbers(element.get(key, ""), 3)
        return a, b, c

    def material(self, element: ElementTree.Element | None) -> Iterable[tuple[str, str]]:
        """The name of a material and its colour; nothing without a colour."""
        colour = None if element is None else element.find("color")
        if element is None or colour is None:
            return
        parts = self.numbers(colour.get("rgba", ""), 4, 1.0)
        # URDF tools disagree whether these are linear; most show them as they are.
        yield element.get("name", ""), "#" + "".join(f"{round(255 * max(0.0, part)):02x}" for part in parts[:3])

    def link(self, element: ElementTree.Element, materials: dict[str, str]) -> UrdfLink:
        return UrdfLink(
            self.text(element, "name"), tuple(self.visual(each, materials) for each in element.findall("visual"))
        )

    def visual(self, element: ElementTree.Element, materials: dict[str, str]) -> UrdfVisual:
        origin, material = element.find("origin"), element.find("material")
        own = dict(self.material(material))
        colour = next(iter(own.values()), "") or materials.get("" if material is None else material.get("name", ""))
        looks = {
            "place": self.vector(origin, "xyz"),
            "rpy": self.vector(origin, "rpy"),
            "colour": colour or _GREY,
        }
        geometry = element.find("geometry")
        shape = next(iter(geometry), None) if geometry is not None else None
        if shape is None:
            raise self.fault("a visual has no geometry")
        if shape.tag == "mesh":
            scale = self.vector(shape, "scale", (1.0, 1.0, 1.0))
            if not all(scale):
                raise self.fault("a mesh has the scale 0")
            return UrdfVisual("mesh", scale, file=self.text(shape, "filename"), **looks)  # type: ignore[arg-type]
        sizes = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}.get(shape.tag)
        if sizes is None:
            raise self.fault(f"a visual is a {shape.tag[:20]!r}, not a box, cylinder, sphere or mesh")
        words = " ".join(self.text(shape, key) for key in sizes)
        size = self.numbers(words, 3 if shape.tag == "box" else len(sizes))
        if not all(part > 0.0 for part in size):
            raise self.fault(f"a {shape.tag} has a length that is not above 0")
        return UrdfVisual(shape.tag, size, **looks)  # type: ignore[arg-type]

    def joint(self, element: ElementTree.Element) -> UrdfJoint:
        origin, name = element.find("origin"), self.text(element, "name")
        moves = element.get("type") in _MOVES
        axis = self.vector(element.find("axis"), "xyz", (1.0, 0.0, 0.0))
        length = math.hypot(*axis)
        if moves and length < 1e-6:
            raise self.fault(f"joint {name}: its axis has no length")
        mimic = element.find("mimic")
        drive = Drive(name)
        if mimic is not None:
            leads = self.text(mimic, "joint")
            (factor,) = self.numbers(mimic.get("multiplier", "1"), 1)
            (offset,) = self.numbers(mimic.get("offset", "0"), 1)
            drive = Drive(leads, factor, offset)
        return UrdfJoint(
            name,
            self.text(element.find("parent"), "link"),
            self.text(element.find("child"), "link"),
            self.vector(origin, "xyz"),
            self.vector(origin, "rpy"),
            (axis[0] / length, axis[1] / length, axis[2] / length) if moves else None,
            element.get("type") == "prismatic",
            drive,
        )

    def tree(self, links: list[UrdfLink], joints: list[UrdfJoint]) -> list[UrdfLink]:
        """The links, each after the one that carries it."""
        by_name = {link.name: link for link in links}
        if len(by_name) < len(links) or len({joint.name for joint in joints}) < len(joints):
            raise self.fault("two links, or two joints, have one name")
        children: dict[str, list[str]] = {}
        carried = set[str]()
        for joint in joints:
            if joint.parent not in by_name or joint.child not in by_name or joint.child in carried:
                raise self.fault(f"joint {joint.name}: a link is unknown, or carried by two joints")
            carried.add(joint.child)
            children.setdefault(joint.parent, []).append(joint.child)
        order = [name for name in by_name if name not in carried]
        if len(order) != 1:
            raise self.fault(f"has {len(order)} links that nothing carries; a robot has one")
        for name in order:
            order += children.get(name, ())
        if len(order) < len(links):
            raise self.fault("its joints go round in a circle")
        return [by_name[name] for name in order]

"""The body of an arm for MuJoCo, made from the shapes that every picture of the arm shows.

Owns bodies, geoms, light, floor and camera. Links with a mass are simulated; those that only follow, such as a
second jaw, are puppets: they are seen and touch nothing. Must not know servos. The caller brings ``mujoco``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from hexwire.model.arms import Rod, record_of
from hexwire.model.palette import joint_colour
from hexwire.model.pose import Vector, quaternion, rotation_from_rpy
from hexwire.model.shapes import COLOURS, ArmShapes, Shape, ShapeJoint, ShapeLink

__all__ = ["CAMERA", "make_body", "puppet_poses", "puppets"]

CAMERA = "view"
"""The camera that sees the whole arm."""

_DAMPING = 0.05
_FRICTION = 0.02
_ROD_RADIUS = 0.012
"""Of the rods whose inertia an arm's record gives the links, metres."""
_TABLE = 1.0
"""Half the length of the table, metres."""
_SIDE, _RISE = 0.95, 0.38
"""How far the camera stands to the right of where the arm points, and above, radians."""


@dataclass(frozen=True, slots=True)
class _Mass:
    kilograms: float
    centre: Vector
    turn: tuple[float, float, float, float]
    moments: tuple[float, float, float]


def make_body(mujoco: Any, shapes: ArmShapes, *, table: bool = True) -> Any:
    """A MuJoCo specification of the arm, with light, floor and a camera; bodies have the names of the links.

    Args:
        mujoco: The module.
        shapes: The arm.
        table: The arm can hit the floor, which is at the height of its foot.
    """
    spec = mujoco.MjSpec()
    spec.modelname = shapes.name
    spec.compiler.degree = False
    # Contacts are between links and table only; positions of geoms do not matter for the masses, which are given.
    _light(mujoco, spec, shapes)
    _floor(mujoco, spec, solid=table)
    _materials(spec, shapes)
    joints = {joint.child: joint for joint in shapes.joints}
    hidden = set(puppets(shapes))
    poses = shapes.poses({})
    bodies: dict[str, Any] = {}
    for link in shapes.links:
        joint = joints.get(link.name)
        if link.name in hidden:
            pose = poses[link.name]
            body = spec.worldbody.add_body(name=link.name, pos=pose.position, mocap=True)
            body.quat = _turn(quaternion(pose.rotation))
        elif joint is None:
            body = spec.worldbody
        else:
            body = bodies[joint.parent].add_body(name=link.name, pos=joint.place)
            body.quat = _turn(quaternion(rotation_from_rpy(*joint.rpy)))
            if joint.axis is not None:
                _hinge(mujoco, body, joint, shapes)
                _weigh(body, link, shapes)
        bodies[link.name] = body
        for shape in link.shapes:
            _geom(mujoco, body, link.name, shape, touches=shape.solid and link.name not in hidden)
    return spec


def puppets(shapes: ArmShapes) -> tuple[str, ...]:
    """Names of the links that only follow others and have no mass of their own."""
    follow = {joint.child for joint in shapes.joints if joint.follows}
    return tuple(link.name for link in shapes.links if link.name in follow and link.inertia is None)


def puppet_poses(
    shapes: ArmShapes, positions: Mapping[str, float]
) -> dict[str, tuple[Vector, tuple[float, float, float, float]]]:
    """Place and quaternion (w, x, y, z) of every puppet at the driver's joint positions in radians."""
    poses = shapes.poses(positions)
    return {name: (poses[name].position, _turn(quaternion(poses[name].rotation))) for name in puppets(shapes)}


def _hinge(mujoco: Any, body: Any, joint: ShapeJoint, shapes: ArmShapes) -> None:
    hinge = body.add_joint(name=joint.name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=joint.axis)
    hinge.range = joint.limits[:2]
    if not _rods(shapes):
        # Of the powers of the speed, only the first.
        hinge.damping, hinge.frictionloss = [_DAMPING, 0.0, 0.0], _FRICTION


def _weigh(body: Any, link: ShapeLink, shapes: ArmShapes) -> None:
    rod = _rods(shapes).get(link.name)
    mass = _mass(link) if rod is None else _rod_mass(rod, link, shapes)
    body.mass, body.ipos, body.iquat = mass.kilograms, mass.centre, mass.turn
    body.inertia = mass.moments
    body.explicitinertial = True


def _mass(link: ShapeLink) -> _Mass:
    inertia = link.inertia
    if inertia is None:
        raise AssertionError(f"{link.name} moves and has no mass")
    across, along = inertia.moments
    middle, rpy = inertia.frame
    return _Mass(inertia.mass, middle, _turn(quaternion(rotation_from_rpy(*rpy))), (across, across, along))


def _rod_mass(rod: Rod, link: ShapeLink, shapes: ArmShapes) -> _Mass:
    x, y, z = rod.centre
    if rod.reference:
        place = next(joint for joint in shapes.joints if joint.name == rod.reference).place
        x, y, z = x + place[0], y + place[1], z + place[2]
    if rod.in_plane and link.inertia is not None:
        y = link.inertia.start[1]
    moment = rod.mass * (3 * _ROD_RADIUS**2 + rod.length**2) / 12
    return _Mass(rod.mass, (x, y, z), (1.0, 0.0, 0.0, 0.0), (moment, moment, moment))


def _rods(shapes: ArmShapes) -> Mapping[str, Rod]:
    record = record_of(shapes.name)
    return {} if record is None else record.rods


# -- what is seen ---------------------------------------------------------------------------------------------


def _geom(mujoco: Any, body: Any, link: str, shape: Shape, *, touches: bool) -> None:
    kinds = {
        "box": mujoco.mjtGeom.mjGEOM_BOX,
        "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
        "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    }
    half = [length / 2 for length in shape.size]
    size = half if shape.kind == "box" else [shape.size[0], *half[1:]]
    body.add_geom(
        name=f"{link}/{shape.name}",
        type=kinds[shape.kind],
        size=[*size, 0.0, 0.0][:3],
        pos=shape.place,
        quat=_turn(quaternion(shape.rotation)),
        material=shape.joint or shape.colour,
        density=0.0,
        # Links touch the table, not one another: the planner checks the joint coupling limit.
        contype=1 if touches else 0,
        conaffinity=0,
    )


def _materials(spec: Any, shapes: ArmShapes) -> None:
    colours = {name: light for name, (light, _) in COLOURS.items()}
    colours |= {name: joint_colour(i) for i, name in enumerate(shapes.driven)}
    for name, colour in colours.items():
        spec.add_material(name=name, rgba=_rgba(colour), specular=0.25, shininess=0.3)


def _light(mujoco: Any, spec: Any, shapes: ArmShapes) -> None:
    reach = shapes.reach
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=_rgba("#f7f9fb")[:3],
        rgb2=_rgba("#b9c4d0")[:3],
        width=256,
        height=256,
    )
    head = spec.visual.headlight
    head.ambient, head.diffuse, head.specular = [0.36] * 3, [0.4] * 3, [0.05] * 3
    spec.visual.map.znear = 0.01
    # Wide enough for the whole arm: beyond its edge the shadow's texture flickers.
    spec.visual.map.shadowclip = 3.0
    spec.visual.global_.offwidth, spec.visual.global_.offheight = 1280, 960
    spec.visual.quality.shadowsize = 2048
    spec.worldbody.add_light(
        name="lamp",
        pos=[0.6 * reach, -reach, 3.0 * reach],
        dir=[-0.2, 0.33, -1.0],
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        diffuse=[0.45] * 3,
        specular=[0.1] * 3,
        castshadow=True,
    )
    _aim(spec, shapes, reach)


def _aim(spec: Any, shapes: ArmShapes, reach: float) -> None:
    """Look at the arm from its right and ahead of it, from above; the viewer's own camera starts there too."""
    side = shapes.heading - _SIDE
    x, y = math.cos(side), math.sin(side)
    level, rise = math.cos(_RISE), math.sin(_RISE)
    away = (level * x, level * y, rise)
    ahead = 0.22 * reach
    target = (ahead * math.cos(side + _SIDE), ahead * math.sin(side + _SIDE), 0.28 * reach)
    place = tuple(t + 1.75 * reach * a for t, a in zip(target, away, strict=True))
    # Columns: to the right, up, and back from what is looked at.
    axes = ((-y, -rise * x, away[0]), (x, -rise * y, away[1]), (0.0, level, away[2]))
    camera = spec.worldbody.add_camera(name=CAMERA, pos=place)
    camera.quat = _turn(quaternion(axes))
    camera.fovy = 30.0
    spec.stat.center, spec.stat.extent = target, 1.0 * reach
    spec.visual.global_.azimuth = math.degrees(side) + 180.0
    spec.visual.global_.elevation = -math.degrees(_RISE)


def _floor(mujoco: Any, spec: Any, *, solid: bool) -> None:
    spec.add_texture(
        name="grid",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
        mark=mujoco.mjtMark.mjMARK_EDGE,
        rgb1=_rgba("#d3dae1")[:3],
        rgb2=_rgba("#d3dae1")[:3],
        markrgb=_rgba("#98a4b1")[:3],
        width=256,
        height=256,
    )
    # One square of the grid is 100 mm.
    floor = spec.add_material(name="floor", texrepeat=[20.0, 20.0], texuniform=True, reflectance=0.04)
    floor.textures[int(mujoco.mjtTextureRole.mjTEXROLE_RGB)] = "grid"
    spec.worldbody.add_geom(
        name="table",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[_TABLE, _TABLE, 0.1],
        material="floor",
        contype=0,
        conaffinity=1 if solid else 0,
    )


def _rgba(colour: str) -> list[float]:
    return [*(int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)), 1.0]


def _turn(xyzw: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    x, y, z, w = xyzw
    return (w, x, y, z)

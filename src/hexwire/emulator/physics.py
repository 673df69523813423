"""The physics twin: emulated servos that move one body in MuJoCo.

Owns the body, made from the shapes that every picture of the arm shows, with its light, floor and camera, and the
coupling: servos give torques, MuJoCo moves links under gravity and contact, servos read their positions. So load,
sag, stops and collisions show up in the registers. Masses and the motors' torques are estimates. Links with a mass
are simulated; those that only follow, such as a second jaw, are puppets: they are seen and touch nothing. Must not
know a board or a line. Needs the package ``mujoco-core``, imported on first use.

Unlike the usual shafts, which follow exact profiles, these are held by a proportional controller as in real servos:
they sag a little under load.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from hexwire.errors import UsageError
from hexwire.model.arm import ArmModel, JointModel
from hexwire.model.arms import Rod, record_of
from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel
from hexwire.model.arms.hex7bot.shapes import LEVEL_JOINT
from hexwire.model.geometry import kinematics_for, make_shapes
from hexwire.model.palette import joint_colour
from hexwire.model.pose import Vector, quaternion, rotation_from_rpy
from hexwire.model.shapes import COLOURS, ArmShapes, Shape, ShapeJoint, ShapeLink
from hexwire.wire.registers import Series

from .servo import EmulatedServo
from .servo_control import MECHANICS
from .servo_motion import TICK, Mechanics, Motion, MotorDrive

__all__ = ["CAMERA", "PhysicsTwin", "make_body", "puppet_poses", "puppets"]

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


_STALL = {"seven_bot": 3.0, "hls": 0.588, "sts_sms": 1.91}
"""Newton metres at full drive: 6 kg cm is published for the HLS, 19.5 for the STS3215; the legacy ones are assumed
to be able to lift the arm."""
_ARMATURE = {"seven_bot": 0.02, "hls": 0.002, "sts_sms": 0.028}
"""Inertia of motor and gears at the joint, kg m^2: an estimate."""
_GAIN = 1 / 64
"""Share of full drive per count of error, about a position gain of 32: full drive at 5.6 degrees."""
_PAYLOAD_RADIUS = 0.01
_WALL = 1.0
"""Share of full drive per count beyond a servo's `obstacle`."""
_AT = 0.5
"""Counts from a mechanical stop within which a shaft is at it."""


class PhysicsTwin:
    """Couples servos to a simulated body, which they move from construction on.

    Args:
        servos: Those whose ids are in the arm's model are coupled; others are left alone.
        model: Geometry and joints of a Hex7Bot, or the joints of an SO arm as it is mounted.
        payload: Kilograms at the tool.
        table: Add a table at the height of the base's foot.

    Raises:
        UsageError: The package ``mujoco-core`` is not installed, or the payload is out of range.
    """

    def __init__(
        self,
        servos: Sequence[EmulatedServo],
        model: Hex7BotModel | ArmModel,
        *,
        payload: float = 0.0,
        table: bool = True,
    ) -> None:
        if not 0 <= payload < 100:
            raise UsageError(f"the payload is {payload:g} kg, but must be 0 or more and less than 100")
        self._mujoco = _load_mujoco()
        arm = model if isinstance(model, ArmModel) else model.arm
        kinematics = kinematics_for(model) if isinstance(model, ArmModel) else model
        if kinematics is None:
            raise UsageError(f"there is no physics for {arm.name}: its lengths are unknown")
        self.shapes = make_shapes(kinematics)
        self._levels = any(joint.name == LEVEL_JOINT for joint in self.shapes.joints)
        pairs = [(servo, joint) for servo in servos if (joint := arm.by_servo(servo.servo_id)) is not None]
        self._model = self._compile(pairs, payload, table)
        self._data = self._mujoco.MjData(self._model)
        self.ticks = 0
        self.shafts: list[_Shaft] = []
        for servo, joint in pairs:
            shaft = _Shaft(self, servo.motion, joint, self._address(joint.name))
            servo.motion = shaft
            self.shafts.append(shaft)
        self._place()

    def _compile(
        self,
        pairs: Sequence[tuple[EmulatedServo, JointModel]],
        payload: float,
        table: bool,
    ) -> Any:
        mujoco = self._mujoco
        spec = make_body(mujoco, self.shapes, table=table)
        spec.option.timestep = TICK
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        if payload:
            # A body of its own: links state their masses, so MuJoCo ignores the masses of their shapes.
            inertia = 0.4 * payload * _PAYLOAD_RADIUS**2
            ball = spec.body(self.shapes.tip).add_body(
                name="payload", mass=payload, inertia=[inertia] * 3, explicitinertial=True
            )
            ball.add_geom(
                name="payload",
                type=mujoco.mjtGeom.mjGEOM_SPHERE,
                size=[_PAYLOAD_RADIUS, 0.0, 0.0],
                material="pad",
                contype=1,
                conaffinity=0,
            )
        if self._levels:
            level = spec.add_equality(type=mujoco.mjtEq.mjEQ_JOINT, name="parallelogram")
            level.objtype = mujoco.mjtObj.mjOBJ_JOINT
            level.name1, level.name2 = LEVEL_JOINT, "J2"
            level.data[:2] = [0.0, -1.0]
            level.solref = [2 * TICK, 1.0]
        for servo, joint in pairs:
            hinge = spec.joint(joint.name)
            hinge.armature = _ARMATURE[joint.series] * _gears(servo.motion.mechanics, joint) ** 2
            stops = servo.motion.stops
            hinge.limited = mujoco.mjtLimited.mjLIMITED_FALSE
            if stops is not None:
                hinge.limited = mujoco.mjtLimited.mjLIMITED_TRUE
                hinge.range = sorted(joint.counts_to_angle(stop) for stop in stops)
                hinge.solref_limit = [2 * TICK, 1.0]
        return spec.compile()

    def _address(self, name: str) -> tuple[int, int]:
        joint = self._mujoco.mj_name2id(self._model, self._mujoco.mjtObj.mjOBJ_JOINT, name)
        return int(self._model.jnt_qposadr[joint]), int(self._model.jnt_dofadr[joint])

    def _place(self) -> None:
        """Put the body's joints at the servos' positions."""
        for shaft in self.shafts:
            self._data.qpos[shaft.place] = shaft.angle
        if self._levels:
            self._level()
        self._mujoco.mj_forward(self._model, self._data)

    def _level(self) -> None:
        level, _ = self._address(LEVEL_JOINT)
        upper, _ = self._address("J2")
        self._data.qpos[level] = -self._data.qpos[upper]

    def advance(self) -> None:
        """Advance servos and body by one tick."""
        data = self._data
        for shaft in self.shafts:
            if shaft.moved_by_hand():
                data.qpos[shaft.place], data.qvel[shaft.rate] = shaft.angle, 0.0
            data.qfrc_applied[shaft.rate] = shaft.push()
            self._model.dof_frictionloss[shaft.rate] = shaft.friction()
        self._mujoco.mj_step(self._model, data)
        for shaft in self.shafts:
            shaft.take(float(data.qpos[shaft.place]), float(data.qvel[shaft.rate]))
        self.ticks += 1

    @property
    def model(self) -> Any:
        """The compiled ``MjModel``."""
        return self._model

    def make_data(self) -> Any:
        """A fresh ``MjData`` for `show`."""
        return self._mujoco.MjData(self._model)

    def positions(self) -> dict[str, float]:
        """Joint positions of the body, radians, for the driver's joints."""
        return {name: float(self._data.qpos[self._address(name)[0]]) for name in self.shapes.driven}

    def show(self, data: Any) -> None:
        """Put an ``MjData`` of the same model into the body's present pose, with the parts that only follow.

        Args:
            data: Of somebody who draws; the body's own is never lent.
        """
        data.qpos[:] = self._data.qpos
        data.time = self._data.time
        for name, (place, turn) in puppet_poses(self.shapes, self.positions()).items():
            mocap = self._model.body(name).mocapid[0]
            data.mocap_pos[mocap], data.mocap_quat[mocap] = place, turn
        self._mujoco.mj_forward(self._model, data)

    @property
    def contacts(self) -> int:
        """Number of contacts between arm and table."""
        return int(self._data.ncon)


class _Shaft(Motion):
    """A servo's shaft that is a joint of the body."""

    def __init__(self, twin: PhysicsTwin, before: Motion, joint: JointModel, address: tuple[int, int]) -> None:
        super().__init__(before.mechanics, before.position)
        self.stops = before.stops
        self.place, self.rate = address
        self._twin = twin
        self._joint = joint
        gears = _gears(before.mechanics, joint)
        self._stall = _STALL[joint.series] * gears
        self._ticks = 0
        self._taken = self.position
        # Critical damping for the inertia of motor, gears and part of the arm.
        inertia = 2.0 * _ARMATURE[joint.series] * gears**2
        stiffness = self._stall * _GAIN / joint.scale
        self._damping = 2.0 * math.sqrt(stiffness * inertia) * joint.scale / self._stall

    @property
    def angle(self) -> float:
        """Joint angle, radians."""
        return self._joint.counts_to_angle(self.position)

    def moved_by_hand(self) -> bool:
        """Whether somebody set the position since the last tick, as a calibration does by whole turns."""
        return self.position != self._taken

    def rename(self, counts: float) -> None:
        super().rename(counts)
        # The body does not move.
        self._joint = replace(self._joint, neutral=self._joint.neutral + round(counts))
        self._taken = self.position

    def command(
        self, drive: MotorDrive, *, target: float, speed: float, acceleration: float, ceiling: float
    ) -> None:
        if self._drive is not MotorDrive.POSITION or drive is not MotorDrive.POSITION:
            self._ahead, self._pace = self.position, self.velocity
        super().command(drive, target=target, speed=speed, acceleration=acceleration, ceiling=ceiling)

    def tick(self) -> None:
        # Servos are stepped one after the other; the first to ask moves all of them.
        if self._ticks >= self._twin.ticks:
            self._twin.advance()
        self._ticks += 1
        self.settled = False

    def push(self) -> float:
        """Torque on the joint, newton metres; also sets what the load register shows."""
        if self._drive is MotorDrive.POSITION:
            self._follow_profile()
            wanted = _GAIN * (self._ahead - self.position) + self._damping * (self._pace - self.velocity)
        elif self._drive is MotorDrive.SPEED:
            wanted = 4 * self._damping * (self._speed - self.velocity)
        elif self._drive is MotorDrive.TORQUE:
            wanted = self._target
        else:
            wanted = 0.0
        self.torque = max(-self._ceiling, min(self._ceiling, wanted))
        outside = self.external_torque + (self._pull() if self.hand is not None else 0.0)
        if self._drive is MotorDrive.DAMPED:
            outside -= self._damping * self.velocity
        low, high = self.obstacle
        self.blocked = False
        for bound, side in ((low, 1.0), (high, -1.0)):
            if bound is not None and (bound - self.position) * side > 0:
                outside += _WALL * (bound - self.position) - self._damping * self.velocity
                self.blocked = True
        if self.stops is not None and not self.stops[0] + _AT < self.position < self.stops[1] - _AT:
            self.blocked = True
        return self._joint.sign * (self.torque + outside) * self._stall

    def friction(self) -> float:
        """Dry friction now, newton metres."""
        powered = self._drive not in {MotorDrive.FREE, MotorDrive.DAMPED} and self._ceiling > 0
        share = self.mechanics.friction if powered else self.mechanics.holding_friction
        return share * self._stall

    def take(self, angle: float, speed: float) -> None:
        """Take position and speed from the body."""
        joint = self._joint
        self.position = joint.sign * (angle - joint.offset) / joint.scale + joint.neutral
        self.velocity = joint.sign * speed / joint.scale
        self._taken = self.position


def _gears(mechanics: Mechanics, joint: JointModel) -> float:
    """Ratio of a servo's gears to the usual ones of its series."""
    return MECHANICS[Series(joint.series)].max_speed / mechanics.max_speed


def _load_mujoco() -> Any:
    try:
        import mujoco
    except ImportError:
        raise UsageError("the physics twin needs MuJoCo: pip install 'hexwire[sim]'") from None
    return mujoco

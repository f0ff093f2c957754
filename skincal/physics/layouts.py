"""The two rigs: an arm of primitives that pokes a part, and a robot (URDF) that presses its part onto a fixed tip."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from skincal.geometry import FloatArray, inverse_pose, length_of, orthonormal_pair
from skincal.mesh.surface import Surface
from skincal.model.errors import InputError
from skincal.model.scene import Scene
from skincal.model.urdf_chain import TURNING_JOINT_KINDS, UrdfJoint
from skincal.physics.effects import Effects
from skincal.physics.engine import INVERSE_KINEMATICS_TOLERANCE_M, Engine
from skincal.physics.mjcf import Joint, RigPlan, write_mjcf
from skincal.physics.rig import RigLayout, rotation_by, soft_axes
from skincal.physics.skin import mount_skin

TOOL_LENGTH_M = 0.10
PART_CENTRE_HEIGHT_M = 0.40
"""m, height of the part's centre over the floor."""
ARM_BASE_TO_PART_M = 0.45
"""m, from the part's centre to the axis of the arm's base."""
UPPER_ARM_M, FOREARM_M = 0.40, 0.40
LINK_MASS_BEFORE_SENSOR_KG = 1.0
"""kg of a link before the sensor. Assumed: the URDF's are not read."""
LINK_MASS_AFTER_SENSOR_KG = 0.05
"""kg of a link between sensor and part."""
MAX_TRIED_JOINT_ANGLE_RAD = 2.0
"""rad, largest angle of an arm pose that is tried for the tip's place."""
TRIED_POSES, TRIED_PLACES = 24, 16
TRIED_PUSH_SLOPE_SD = 0.25
"""Slope, sd in each direction, of the pushes that are tried."""
TRIED_TIP_HEIGHT_M = 0.03
TIP_START_HEIGHT_M = 0.06
"""m, from the skin to the tip at the start."""
INVERSE_KINEMATICS_RESTARTS = 4


def _pose(shift: tuple[float, float, float] | FloatArray = (0.0, 0.0, 0.0), rotation: FloatArray | None = None) -> FloatArray:
    pose = np.eye(4)
    pose[:3, 3] = shift
    if rotation is not None:
        pose[:3, :3] = rotation
    return pose


def poking_arm(scene: Scene, surface: Surface, pose: str = "") -> RigLayout:
    """Lay out the arm of primitives at the end of the part; the part rests in an arm pose, by default the first one."""
    angles = np.empty(0)
    link_from_sensor = scene.sensor_pose
    if scene.arm is not None:
        poses = scene.arm.poses
        angles = poses[pose or next(iter(poses))] if poses else np.zeros(len(scene.arm.arm.joints))
        link_from_sensor = scene.arm.arm.link_from_sensor(angles)
    world_from_link, centre, tip_chain, start, seeds = place_arm_and_part(surface)
    part_chain = [
        Joint(world_from_link @ link_from_sensor, None, mass=1.0, trembles=True),
        Joint(np.eye(4), None, sensor_pose=np.eye(4)),
        Joint(inverse_pose(link_from_sensor), None),
    ]
    plan = RigPlan(part_chain, centre, tip_chain, TOOL_LENGTH_M, False, soft_axes(scene, angles))
    record = np.zeros(0 if scene.arm is None else max(scene.arm.arm.joints) + 1)
    if scene.arm is not None:
        record[list(scene.arm.arm.joints)] = angles
    return RigLayout(plan, start, seeds, lambda _: angles, lambda _: record)


def place_arm_and_part(surface: Surface) -> tuple[FloatArray, FloatArray, list[Joint], FloatArray, FloatArray]:
    """Place a part over the floor, and an arm of primitives at its end.

    Returns
    -------
    World_from_link (4, 4), centre of the part (3,) in its frame, metres; the chain of the arm up to its flange; its angles at
    the start (joints,), and other starts of the inverse kinematics (n, joints), radians.
    """
    centre = (surface.vertices.min(axis=0) + surface.vertices.max(axis=0)) / 2.0
    world_from_link = _pose(np.array([0.0, 0.0, PART_CENTRE_HEIGHT_M]) - centre)
    y, z = np.eye(3)[1:]
    # All joints turn about z or y; at 0 the arm is stretched upwards.
    tip_chain = [
        Joint(_pose((0.0, ARM_BASE_TO_PART_M, 0.2)), z, mass=3.0),
        Joint(_pose((0.0, 0.0, 0.1)), y, (-2.4, 2.4), 2.0, np.array([0.0, 0.0, UPPER_ARM_M / 2.0])),
        Joint(_pose((0.0, 0.0, UPPER_ARM_M)), y, (-2.7, 2.7), 1.5, np.array([0.0, 0.0, FOREARM_M / 2.0])),
        Joint(_pose((0.0, 0.0, FOREARM_M)), z, (-6.0, 6.0), 0.3),
        Joint(_pose(), y, (-2.4, 2.4), 0.3),
        Joint(_pose((0.0, 0.0, 0.05)), z, (-6.0, 6.0), 0.2),
    ]
    yaw = -np.pi / 2.0
    start = np.array([yaw, -0.2, 1.7, 0.0, 1.5, 0.0])
    seeds = np.array(
        [[yaw + turn, 0.2, 1.2, roll, bend, 0.0] for turn in (-0.5, 0.5) for roll in (0.0, 1.5, -1.5) for bend in (0.8, 1.6)]
    )
    return world_from_link, centre, tip_chain, start, seeds


def moving_part(scene: Scene, surface: Surface) -> RigLayout:
    """Lay out a robot (URDF) that carries part and sensor, and a fixed tip where most of the skin gets to.

    Raises InputError: the sensor is not between the robot's root and the part.
    """
    spec = scene.robot
    assert spec is not None, "the scene has a robot"
    joints = spec.urdf.path_to_root(scene.link)[::-1]
    names = [joint.name for joint in joints]
    at_sensor = spec.urdf.sensor_named(spec.sensor, str(scene.path)).joint
    if at_sensor not in names:
        raise InputError(
            f"{scene.path}: the sensor {spec.sensor} is at no joint between {scene.link} and the root of "
            f"{spec.urdf.path.name}; a robot that presses its part onto a fixed tip needs it there: name a joint."
        )
    mimics = [step.joint.name for step in spec.chain.steps if step.follows and step.driver not in spec.chain.fixed]
    if mimics:
        raise InputError(
            f"{scene.path}: joint {mimics[0]} follows another joint; the physics engine has no such joints: simulate without "
            "it (--physics)."
        )
    drivers = {**dict.fromkeys((joint.name for joint in spec.chain.moving), 0.0), **spec.chain.fixed}
    fixed = {step.joint.name: step.angle(drivers) for step in spec.chain.steps}
    streamed = {joint.name for joint in spec.chain.moving}
    behind = names.index(at_sensor)
    chain: list[Joint] = []
    moving: list[str] = []
    for number, joint in enumerate(joints):
        # A joint between sensor and part that is not streamed rests.
        turns = joint.kind in TURNING_JOINT_KINDS and (joint.name in streamed or number < behind)
        moving += [joint.name] * turns
        chain.append(
            Joint(
                joint.origin if turns else joint.transform(fixed.get(joint.name, 0.0)),
                joint.axis if turns else None,
                joint.limits or (-np.pi, np.pi),
                LINK_MASS_BEFORE_SENSOR_KG if number < behind else LINK_MASS_AFTER_SENSOR_KG * turns,
                sensor_pose=_sensor_in_child(scene, joints[number + 1 :], fixed) if number == behind else None,
            )
        )
    columns = spec.chain.joints
    rows = [moving.index(joint.name) for joint in spec.chain.moving]

    def record(angles: FloatArray) -> FloatArray:
        values = np.zeros(max(columns, default=-1) + 1)
        values[list(columns)] = angles[rows]
        return values

    middle = (surface.vertices.min(axis=0) + surface.vertices.max(axis=0)) / 2.0
    plan, start, seeds = _place_tip(scene, surface, chain, middle)
    return RigLayout(plan, start, seeds, lambda angles: angles[rows], record)


def _sensor_in_child(scene: Scene, after: Sequence[UrdfJoint], fixed: Mapping[str, float]) -> FloatArray:
    """Compute the pose (4, 4) of the sensor in the child of its joint, from the joints `after` it up to the part."""
    assert scene.robot is not None
    pose = np.eye(4)
    for joint in after:
        pose = pose @ joint.transform(fixed.get(joint.name, 0.0))
    return pose @ scene.robot.chain.link_from_sensor(np.zeros(len(scene.robot.chain.moving)))


def _place_tip(
    scene: Scene, surface: Surface, chain: Sequence[Joint], middle: FloatArray
) -> tuple[RigPlan, FloatArray, FloatArray]:
    """Place the tip over the middle of the skin, in the best of some arm poses: the one from which most of the skin gets there.

    Returns
    -------
    The plan, the angles of that pose (joints,) and other starts (n, joints), radians.
    """
    _, places, normals = mount_skin(scene, surface)
    rng = np.random.default_rng(0)
    limits = np.array([joint.limits for joint in chain if joint.axis is not None])
    low, high = np.maximum(limits[:, 0], -MAX_TRIED_JOINT_ANGLE_RAD), np.minimum(limits[:, 1], MAX_TRIED_JOINT_ANGLE_RAD)
    best: tuple[int, RigPlan, FloatArray, Engine] | None = None
    tries = rng.choice(len(places), TRIED_PLACES)
    tilts = TRIED_PUSH_SLOPE_SD * rng.standard_normal((TRIED_PLACES, 3))
    for _ in range(TRIED_POSES):
        angles = low + (high - low) * rng.uniform(0.15, 0.85, len(limits))
        plan = RigPlan(chain, middle, [Joint(_tip_base(chain, angles, places, normals), None)], TOOL_LENGTH_M, True)
        engine = Engine(write_mjcf(plan, Effects.none()), surface, angles, (np.zeros(3), np.eye(3)))
        count = 0
        for place, normal, tilt in zip(places[tries], normals[tries], tilts, strict=True):
            push = tilt - normal
            push = push / length_of(push)
            count += engine.solve_angles(angles, place - TRIED_TIP_HEIGHT_M * push, push)[1] < INVERSE_KINEMATICS_TOLERANCE_M
        if best is None or count > best[0]:
            best = count, plan, angles, engine
    assert best is not None
    _, plan, start, _ = best
    seeds = np.clip(start + 0.5 * rng.standard_normal((INVERSE_KINEMATICS_RESTARTS, len(start))), limits[:, 0], limits[:, 1])
    return plan, start, seeds


def _tip_base(chain: Sequence[Joint], angles: FloatArray, places: FloatArray, normals: FloatArray) -> FloatArray:
    """Compute the pose (4, 4) of the wrist of a tip that points at the middle of the skin, if the arm has these angles."""
    pose, left = np.eye(4), list(angles)
    for joint in chain:
        pose = pose @ joint.pose
        if joint.axis is not None:
            pose[:3, :3] = pose[:3, :3] @ rotation_by(left.pop(0) * joint.axis)
    push = -pose[:3, :3] @ normals.mean(axis=0)
    push = push / length_of(push)
    middle = pose[:3, :3] @ places[((places - places.mean(axis=0)) ** 2).sum(axis=1).argmin()] + pose[:3, 3]
    wrist = np.eye(4)
    wrist[:3, :2] = orthonormal_pair(push[None])[0].T
    wrist[:3, 2] = push
    wrist[:3, 3] = middle - (TOOL_LENGTH_M + TIP_START_HEIGHT_M) * push
    return wrist

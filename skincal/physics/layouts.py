"""The two rigs: an arm of primitives that pokes a part, and a robot (URDF) that presses its part onto a fixed tip."""

from __future__ import annotations

import numpy as np

from skincal.geometry import FloatArray, inverse_pose
from skincal.mesh.surface import Surface
from skincal.model.scene import Scene
from skincal.physics.effects import Effects
from skincal.physics.mjcf import Joint, RigPlan
from skincal.physics.rig import RigLayout, SimulatedRobot, soft_axes

TOOL_LENGTH_M = 0.10
LIFT_M = 0.40
"""m, height of the part's centre over the floor."""
STAND_OFF_M = 0.45
"""m, from the part's centre to the axis of the arm's base."""
UPPER_ARM_M, FOREARM_M = 0.40, 0.40


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
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    centre = (low + high) / 2.0
    world_from_link = _pose(np.array([0.0, 0.0, LIFT_M]) - centre)
    part_chain = [
        Joint(world_from_link @ link_from_sensor, None, mass=1.0, trembles=True),
        Joint(np.eye(4), None, sensor_pose=np.eye(4)),
        Joint(inverse_pose(link_from_sensor), None),
    ]
    y, z = np.eye(3)[1:]
    # All joints turn about z or y; at 0 the arm is stretched upwards.
    tip_chain = [
        Joint(_pose((0.0, STAND_OFF_M, 0.2)), z, mass=3.0),
        Joint(_pose((0.0, 0.0, 0.1)), y, (-2.4, 2.4), 2.0, np.array([0.0, 0.0, UPPER_ARM_M / 2.0])),
        Joint(_pose((0.0, 0.0, UPPER_ARM_M)), y, (-2.7, 2.7), 1.5, np.array([0.0, 0.0, FOREARM_M / 2.0])),
        Joint(_pose((0.0, 0.0, FOREARM_M)), z, (-6.0, 6.0), 0.3),
        Joint(_pose(), y, (-2.4, 2.4), 0.3),
        Joint(_pose((0.0, 0.0, 0.05)), z, (-6.0, 6.0), 0.2),
    ]
    plan = RigPlan(part_chain, centre, tip_chain, TOOL_LENGTH_M, False, soft_axes(scene, angles))
    yaw = -np.pi / 2.0
    start = np.array([yaw, -0.2, 1.7, 0.0, 1.5, 0.0])
    seeds = np.array(
        [[yaw + turn, 0.2, 1.2, roll, bend, 0.0] for turn in (-0.5, 0.5) for roll in (0.0, 1.5, -1.5) for bend in (0.8, 1.6)]
    )
    record = np.zeros(0 if scene.arm is None else max(scene.arm.arm.joints) + 1)
    if scene.arm is not None:
        record[list(scene.arm.arm.joints)] = angles
    return RigLayout(plan, start, seeds, lambda _: angles, lambda _: record)


def make_robot(scene: Scene, surface: Surface, effects: Effects, seed: int) -> SimulatedRobot:
    """Make the rig that fits the scene."""
    return SimulatedRobot(scene, surface, poking_arm(scene, surface), effects, seed)

"""A rig in the physics engine MuJoCo: contact with the part's mesh, sensor readings, and the kinematics of the arm.

MuJoCo replaces a mesh by its convex hull when it looks for contacts. So the tip touches a flat facet instead: before each
period the facet is placed on the layer's outer face, at the mesh point that is nearest to the tip. Normal force, friction and
slip are the engine's (docs/decisions/physics-engine.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np

from skincal.geometry import FloatArray, crossed, inverse_pose, length_of
from skincal.mesh.search import nearest_points
from skincal.mesh.surface import Surface
from skincal.model.errors import InputError
from skincal.physics.mjcf import (
    CONTACT_IMPEDANCE,
    FOAM_DAMPING_OVER_STIFFNESS_S,
    FOAM_STIFFNESS_N_PER_M,
    FOAM_THICKNESS_M,
    PHYSICS_TIME_STEP_S,
)

PHYSICS_STEPS_PER_CONTROL_PERIOD = 4
PERIOD_S = PHYSICS_STEPS_PER_CONTROL_PERIOD * PHYSICS_TIME_STEP_S
"""s between two commands, and two readings of the sensor."""
FACET_UPDATE_MAX_DISTANCE_M = 0.008
"""m. Farther from the mesh the facet is not placed in each period."""
TIP_MAX_MOVE_PER_PERIOD_M = 0.002
"""m, way of the tip in a period at 0.5 m/s: no arm here is faster."""
KEEP_FACET_MAX_TIP_MOVE_M = 1e-6
"""m. A tip that moved less keeps its facet."""
IK_STEPS, IK_DAMPING = 60, 1e-3
INVERSE_KINEMATICS_TOLERANCE_M = 1e-4
"""m, and 10 times as many radians."""
MAX_JOINT_CHANGE_PER_STEP_RAD = 0.2
"""rad, largest change of a joint in one step of the inverse kinematics."""
LENGTH_EQUAL_TO_ONE_RAD_M = 0.1
"""m. A direction error of 1 rad counts as much as this position error."""


def load_mujoco() -> Any:
    """Import MuJoCo. Raises InputError: it is not installed."""
    try:
        return import_module("mujoco")
    except ImportError:
        raise InputError(
            "the physics engine MuJoCo is not installed; install it: python -m pip install 'skincal[physics]' "
            "(or python3 start.py --physics)"
        ) from None


@dataclass(frozen=True, slots=True, eq=False)
class Touch:
    """Contact of the tip with the layer's outer face, part's frame."""

    point: FloatArray
    """(3,) float, metres: the middle of the overlap of tip and layer, which MuJoCo takes for the contact. At 9 N it is 0.5 mm
    below the outer face."""
    normal: FloatArray
    """(3,) float, unit, outward."""
    force: FloatArray
    """(3,) float, N, on the part."""
    depth: float
    """m, how far the tip is in the layer."""


class Engine:
    """MuJoCo with the model of one rig.

    Parameters
    ----------
    mjcf : text of `write_mjcf`
    surface : mesh on which the taxels lie, part's frame
    start : (joints,) float, radians: actuated joints at the start
    base_error : shift and turn for `displace_base`
    """

    def __init__(self, mjcf: str, surface: Surface, start: FloatArray, base_error: tuple[FloatArray, FloatArray]) -> None:
        self.mujoco = mujoco = load_mujoco()
        self.surface = surface
        self.model: Any = mujoco.MjModel.from_xml_string(mjcf)
        self.data: Any = mujoco.MjData(self.model)
        self._nominal: Any = mujoco.MjModel.from_xml_string(mjcf)
        self._believed: Any = mujoco.MjData(self._nominal)
        model = self.model
        self._part, self._tip = model.body("part").id, model.site("tip").id
        self._facet, self._wrist = model.body("facet").id, model.body("wrist").id
        self._joints = model.actuator_trnid[:, 0]
        self._angles, self._dofs = model.jnt_qposadr[self._joints], model.jnt_dofadr[self._joints]
        self.limits = model.jnt_range[self._joints]
        self._far_for = 0
        self._facet_for = np.full(3, np.inf)
        self._set_layer_stiffness()
        self.data.qpos[self._angles] = start
        self.data.ctrl[:] = self._goals = start
        self.displace_base(*base_error)
        mujoco.mj_forward(self.model, self.data)
        self._place_facet()

    def displace_base(self, shift: FloatArray, turn: FloatArray) -> None:
        """Move the tip's base by `shift` (3,), metres, world, and `turn` (3, 3) about the part's origin.

        The joints do not know of it.
        """
        self.mujoco.mj_kinematics(self.model, self.data)
        pivot, base = self.data.xpos[self._part].copy(), self.model.body("t0").id
        self.model.body_pos[base] = pivot + turn @ (self.model.body_pos[base] - pivot) + shift
        turned = np.zeros(9)
        self.mujoco.mju_quat2Mat(turned, self.model.body_quat[base])
        self.mujoco.mju_mat2Quat(self.model.body_quat[base], (turn @ turned.reshape(3, 3)).ravel())

    def displace_tip(self, shift: FloatArray) -> None:
        """Move the tip by `shift` (3,), metres, wrist frame: its tool centre point is wrong by as much."""
        self.model.body_pos[self._wrist] = self.model.body_pos[self._wrist] + shift

    def believe_part(self, world_from_part: FloatArray) -> None:
        """Let the arm believe that a part at rest has this pose (4, 4), metres; nothing moves."""
        body = self._nominal.body("p0").id
        self._nominal.body_pos[body] = world_from_part[:3, 3]
        self.mujoco.mju_mat2Quat(self._nominal.body_quat[body], world_from_part[:3, :3].ravel())

    def part_in_arm(self) -> FloatArray:
        """Compute the true pose (4, 4) of a part at rest in the world as the arm knows it, whose base is displaced."""
        place, turn = self.part_pose()
        true, known = (self._arm_base(model) for model in (self.model, self._nominal))
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn, place
        return known @ inverse_pose(true) @ pose

    def _arm_base(self, model: Any) -> FloatArray:
        """Compute the pose (4, 4) of the arm's first body in the world at angle 0, metres."""
        body, pose, turn = model.body("t0").id, np.eye(4), np.zeros(9)
        self.mujoco.mju_quat2Mat(turn, model.body_quat[body])
        pose[:3, :3], pose[:3, 3] = turn.reshape(3, 3), model.body_pos[body]
        return pose

    @property
    def time_s(self) -> float:
        return float(self.data.time)

    def _set_layer_stiffness(self) -> None:
        """Make the contact a spring of `FOAM_STIFFNESS_N_PER_M`.

        MuJoCo's reference acceleration is -b v - k r, and a constant impedance d makes the force k r / ((1 - d) A), A the
        engine's estimate of the inverse mass at the contact (MuJoCo documentation, Computation, Constraint model).
        """
        inverse_mass = float(self.model.body_invweight0[[self._facet, self._wrist], 0].sum())
        stiffness = FOAM_STIFFNESS_N_PER_M * (1.0 - CONTACT_IMPEDANCE) * inverse_mass
        self.model.pair_solref[0] = -stiffness, -stiffness * FOAM_DAMPING_OVER_STIFFNESS_S

    def advance(self) -> None:
        """Advance by one period."""
        if self._far_for:
            self._far_for -= 1
        else:
            self._place_facet()
        # Goals that jump each period would make the part's inertia felt in every reading.
        change = (self._goals - self.data.ctrl) / PHYSICS_STEPS_PER_CONTROL_PERIOD
        for _ in range(PHYSICS_STEPS_PER_CONTROL_PERIOD):
            self.data.ctrl[:] += change
            self.mujoco.mj_step(self.model, self.data)

    def _place_facet(self) -> None:
        """Place the facet tangent to the layer's outer face, under the tip."""
        centre = self.tip_in_part()[0]
        if length_of(centre - self._facet_for) < KEEP_FACET_MAX_TIP_MOVE_M:
            return
        self._facet_for = centre
        points, triangles = nearest_points(self.surface, centre[None])
        away = centre - points[0]
        distance, outward = length_of(away), self.surface.normals[triangles[0]]
        # The tip is outside unless it went through the layer: then the triangle's normal says where outside is.
        normal = away / distance if distance > 1e-9 and away @ outward > 0 else outward
        self._far_for = (
            int((distance - FACET_UPDATE_MAX_DISTANCE_M) / TIP_MAX_MOVE_PER_PERIOD_M)
            if distance > FACET_UPDATE_MAX_DISTANCE_M
            else 0
        )
        self.model.body_pos[self._facet] = points[0] + FOAM_THICKNESS_M * normal
        self.mujoco.mju_quatZ2Vec(self.model.body_quat[self._facet], normal)

    def touch(self) -> Touch | None:
        """Return the present contact, or `None`."""
        if not self.data.ncon:
            return None
        contact, wrench = self.data.contact[0], np.zeros(6)
        self.mujoco.mj_contactForce(self.model, self.data, 0, wrench)
        # Rows of the frame: normal from the tip to the facet, since the engine puts spheres first, and two tangents. The force
        # acts on the facet.
        frame = contact.frame.reshape(3, 3)
        place, turn = self.part_pose()
        return Touch(
            turn.T @ (contact.pos - place), -(turn.T @ frame[0]), turn.T @ (frame.T @ wrench[:3]), -float(contact.dist)
        )

    def part_pose(self) -> tuple[FloatArray, FloatArray]:
        """Return the true position (3,), metres, and rotation (3, 3) of the part in the world."""
        return self.data.xpos[self._part].copy(), self.data.xmat[self._part].reshape(3, 3).copy()

    def tip_in_part(self, data: Any = None) -> tuple[FloatArray, FloatArray]:
        """Return the true position (3,), metres, and direction (3,) of the tip in the part's frame; or those of `data`."""
        data = self.data if data is None else data
        turn = data.xmat[self._part].reshape(3, 3)
        return (data.site_xpos[self._tip] - data.xpos[self._part]) @ turn, data.site_xmat[self._tip].reshape(3, 3)[:, 2] @ turn

    def sensor_wrench(self) -> FloatArray:
        """Return the force, N, and moment, N m, (6,) that the load exerts on the sensor, in its frame, without errors."""
        # The engine gives what the sensor exerts on the load.
        return -self.data.sensordata[:6]

    def believed_weight(self, angles: FloatArray) -> FloatArray:
        """Compute the weight of the sensor's load as the joints report it: (6,) N and N m, sensor frame."""
        data, model = self._believe(angles), self._nominal
        self.mujoco.mj_comPos(model, data)
        body, site = model.body("sensor").id, model.site("ft").id
        turn = data.site_xmat[site].reshape(3, 3)
        force = model.body_subtreemass[body] * model.opt.gravity
        return np.concatenate([force @ turn, crossed(data.subtree_com[body] - data.site_xpos[site], force) @ turn])

    def push_joints(self, torques: FloatArray) -> None:
        """Apply generalized forces (nv,) during the next periods."""
        self.data.qfrc_applied[:] = torques

    def drive(self, angles: FloatArray) -> None:
        """Set the goals of the joint servos at the end of the next period, radians."""
        self._goals = angles

    # ---- kinematics of the commanded joints: without sag, wrist and vibration

    def _believe(self, angles: FloatArray) -> Any:
        """Compute MuJoCo's data of the rig as its joints report it."""
        self._believed.qpos[self._angles] = angles
        self.mujoco.mj_kinematics(self._nominal, self._believed)
        return self._believed

    def believed_tip(self, angles: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return position (3,), metres, and direction (3,) of the tip in the part's frame if the joints were rigid."""
        return self.tip_in_part(self._believe(angles))

    def believed_body(self, name: str, angles: FloatArray) -> FloatArray:
        """Compute the pose (4, 4) of a body in the world, metres, if the joints were rigid."""
        data, pose, body = self._believe(angles), np.eye(4), self._nominal.body(name).id
        pose[:3, :3], pose[:3, 3] = data.xmat[body].reshape(3, 3), data.xpos[body]
        return pose

    def believed_part(self, angles: FloatArray) -> FloatArray:
        """Compute the pose (4, 4) of the part in the world, metres, if the joints were rigid."""
        data, pose = self._believe(angles), np.eye(4)
        pose[:3, :3], pose[:3, 3] = data.xmat[self._part].reshape(3, 3), data.xpos[self._part]
        return pose

    def solve_angles(
        self, start: FloatArray, position: FloatArray, direction: FloatArray, steps: int = IK_STEPS
    ) -> tuple[FloatArray, float]:
        """Solve the joint angles for a tip's position (3,) and direction (3,), from `start`: damped least squares.

        Returns
        -------
        The angles within their limits, and the remaining error, metres (`LENGTH_EQUAL_TO_ONE_RAD_M`).
        """
        angles, error = start.copy(), np.inf
        for _ in range(steps):
            at, along = self.believed_tip(angles)
            turn = crossed(along, direction)
            if along @ direction < 0:
                # Beyond 90 degrees the cross product shrinks again.
                turn = turn / max(length_of(turn), 1e-9)
            off = np.concatenate([position - at, LENGTH_EQUAL_TO_ONE_RAD_M * turn])
            error = length_of(off)
            if error < INVERSE_KINEMATICS_TOLERANCE_M / 10:
                break
            jacobian = self._jacobian(along)
            step = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + IK_DAMPING**2 * np.eye(6), off)
            largest = float(np.abs(step).max())
            angles = np.clip(
                angles + step * min(1.0, MAX_JOINT_CHANGE_PER_STEP_RAD / max(largest, 1e-9)),
                self.limits[:, 0],
                self.limits[:, 1],
            )
        return angles, error

    def _jacobian(self, along: FloatArray) -> FloatArray:
        """Return d(position, weighted direction)/d(angles), (6, joints), part's frame; a turn about the tip is left out."""
        data, model, mujoco = self._believed, self._nominal, self.mujoco
        mujoco.mj_comPos(model, data)
        point = data.site_xpos[self._tip]
        moved, turned = np.zeros((2, 2, 3, model.nv))
        mujoco.mj_jac(model, data, moved[0], turned[0], point, self._wrist)
        mujoco.mj_jac(model, data, moved[1], turned[1], point, self._part)
        turn = data.xmat[self._part].reshape(3, 3).T
        position = turn @ (moved[0] - moved[1])[:, self._dofs]
        spin = turn @ (turned[0] - turned[1])[:, self._dofs]
        return np.concatenate([position, LENGTH_EQUAL_TO_ONE_RAD_M * (spin - np.outer(along, along @ spin))])

"""A simulated arm that holds a tool and presses a still part: the way of the tool, its reported poses, and its weight.

The tool's z axis is the axis of its tip, and lies along the push. Between two presses the arm lifts the tip, turns the tool in
half a second, and rests above the skin: sensor and skin are tared there. A press moves the tip along its axis only.

The part lies in the base where the scene says, or else at a pose that is drawn. Errors: `RigErrors`, `tool_...`.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from skincal.geometry import FloatArray, inverse_pose, orthonormal_pair, rotation_by, rotations
from skincal.model.tool_rig import ToolSpec

if TYPE_CHECKING:
    from skincal.simulation.rig_errors import RigErrors

DEFAULT_TIP_M = (0.0, 0.0, 0.12)
"""m, end of the tip in the tool's frame if the scene has none."""
MOVE_S, REST_S, APPROACH_S = 0.5, 0.65, 0.15
"""s: the way above the next place, the rest there (half a second is asked), and from there to the skin."""
ABOVE_M, DEPTH_M, LIFT_M = 0.005, 0.0015, 0.03
"""m: of the resting tip above the skin, of the foam under full force, and of the way from place to place."""
TWIST_RAD = 1.0
"""rad, largest turn of the tool about its axis."""
MASS_KG, CENTRE_OF_MASS_M = 0.5, 0.05
"""Tool beyond the sensor, and the distance of its centre along the tool's axis."""
STANDARD_GRAVITY = 9.81
POSITION_ERROR_LENGTH_M = 0.3
"""m, over which a robot's position error changes; assumed."""
NEAR_M, FAR_M, LOW_M, HIGH_M = 0.35, 0.60, 0.05, 0.35
"""m: distances of a drawn part from the base's axis, and its height."""


class TimedPress(Protocol):
    """A press over time."""

    @property
    def begin(self) -> float:
        """s, first touch."""
        ...

    @property
    def end(self) -> float:
        """s, end of contact."""
        ...

    def load(self, times: FloatArray) -> FloatArray:
        """Return the force relative to the full force at each time, s."""
        ...

    def travel(self, times: FloatArray) -> FloatArray:
        """Compute how far the tip has slid (..., 3) on the skin, metres, at `times` (...), s."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class ToolWay:
    """The tool from the decision for a press until the next one, link frame."""

    start: float
    """s."""
    press: TimedPress | None
    """`None`: the tool stays above `place`."""
    from_place: FloatArray
    """(3,) float, metres: end of the tip above the last place."""
    from_turn: FloatArray
    """(3, 3) float: rotation of the tool there."""
    place: FloatArray
    """(3,) float, metres: touched point."""
    turn: FloatArray
    """(3, 3) float: rotation of the tool while it presses."""
    way: FloatArray
    """(3,) float, rad, link frame: rotation vector from `from_turn` to `turn`."""

    @property
    def above(self) -> FloatArray:
        """(3,) float, metres: end of the tip while it rests above the place."""
        return self.place - ABOVE_M * self.turn[:, 2]

    def tips(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute rotations (n, 3, 3) and ends of the tip (n, 3), metres, link frame, at `times` (n,), s."""
        if self.press is None:
            return np.broadcast_to(self.turn, (len(times), 3, 3)), np.broadcast_to(self.above, (len(times), 3))
        press, axis = self.press, self.turn[:, 2]
        seconds = min(MOVE_S, max(press.begin - APPROACH_S - self.start, 1e-3))
        share = _smooth_step((times - self.start) / seconds)
        turns = rotations(share[:, None] * self.way) @ self.from_turn
        lift = LIFT_M * np.sin(np.pi * share)[:, None] * -axis
        places = self.from_place + share[:, None] * (self.above - self.from_place) + lift
        near = _smooth_step((times - press.begin + APPROACH_S) / APPROACH_S)
        away = _smooth_step((times - press.end) / APPROACH_S)
        load = np.clip(press.load(times), 0.0, 1.0)
        # On its way down ABOVE_M to the outer face of the foam, DEPTH_M above the pressed one; then by the load.
        down = (ABOVE_M - DEPTH_M) * near * (1.0 - away) + DEPTH_M * load
        slid = np.where((times < press.end)[:, None], press.travel(times), 0.0)
        return turns, places + down[:, None] * axis + slid


class SimulatedTool:
    """The tool of a rig, its way, and what its devices report.

    Parameters
    ----------
    spec : of the scene
    errors : of the rig
    rng : draws the part's pose in the base, errors that stay, and the turns of the tool about its axis
    """

    def __init__(self, spec: ToolSpec, errors: RigErrors, rng: np.random.Generator) -> None:
        part, arm, self._twists = rng.spawn(3)
        self.spec, self._errors = spec, errors
        drawn = _draw_part_pose(part)
        self.base_from_link: FloatArray = inverse_pose(spec.link_from_base) if spec.has_part_pose else drawn
        """(4, 4) float, metres: true pose of the part."""
        given = np.array(DEFAULT_TIP_M) if spec.tip is None else spec.tip
        off = errors.tool_tip / np.sqrt(3.0) * arm.standard_normal(3)
        self.tip: FloatArray = given + off
        """(3,) float, metres, tool frame: true end of the tip."""
        self._scale = errors.tool_scale * arm.standard_normal()
        self._waves = arm.standard_normal((3, 3)) / POSITION_ERROR_LENGTH_M
        self._phases = arm.uniform(0.0, 2.0 * np.pi, 3)
        self._directions = rotation_by(arm.standard_normal(3))
        home = np.eye(3)
        self._ways = [ToolWay(-np.inf, None, np.zeros(3), home, np.array([0.0, 0.0, 0.2]), home, np.zeros(3))]
        self._starts = [-np.inf]

    def plan_press(self, now: float, press: TimedPress, place: FloatArray, push: FloatArray) -> None:
        """Move the tool to a press; it leaves the place before at `now`, s.

        `place` (3,), metres, and the unit `push` (3,) are in the link frame.
        """
        last = self._ways[-1]
        first, second = orthonormal_pair(push[None])[0]
        turn = np.column_stack([first, second, push])
        turn = turn @ rotation_by(np.array([0.0, 0.0, TWIST_RAD * self._twists.uniform(-1.0, 1.0)]))
        self._ways.append(ToolWay(now, press, last.above, last.turn, place, turn, _vector_of(turn @ last.turn.T)))
        self._starts.append(now)

    def poses(self, times: FloatArray) -> FloatArray:
        """Compute the true poses (n, 4, 4) of the tool in the link, metres, at ascending `times` (n,), s."""
        found = np.tile(np.eye(4), (len(times), 1, 1))
        rows = [bisect_right(self._starts, at) - 1 for at in times.tolist()]
        for row in sorted(set(rows)):
            own = np.array(rows) == row
            turns, tips = self._ways[row].tips(times[own])
            found[own, :3, :3] = turns
            found[own, :3, 3] = tips - turns @ self.tip
        return found

    def reported(self, times: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Compute the reported poses (n, 7) of the tool in the base at `times`, s: x y z, metres, and quaternion x y z w."""
        errors, count = self._errors, len(times)
        true = self.base_from_link @ self.poses(times - errors.tool_delay)
        waves = np.sin(true[:, :3, 3] @ self._waves.T + self._phases)
        # A sine has a variance of one half.
        smooth = errors.tool_position * np.sqrt(2.0 / 3.0) * waves @ self._directions
        noise = errors.tool_noise / np.sqrt(3.0) * rng.standard_normal((count, 3))
        places = (1.0 + self._scale) * true[:, :3, 3] + smooth + noise
        turns = rotations(errors.tool_turn_noise * rng.standard_normal((count, 3))) @ true[:, :3, :3]
        return np.concatenate([places, _rotation_class().from_matrix(turns).as_quat()], axis=1)

    def wrenches(self, times: FloatArray, forces: FloatArray, points: FloatArray) -> FloatArray:
        """Compute wrenches (n, 6) in the sensor's frame without its errors, as the sensor below the part has their sign.

        Parameters
        ----------
        times : (n,) float, s, ascending
        forces, points : (n, 3) float, N and metres, link frame: force on the part, and its point
        """
        poses = self.poses(times)
        back = poses @ self.spec.tool_from_sensor
        turn, origin = back[:, :3, :3].transpose(0, 2, 1), back[:, :3, 3]
        down = self.base_from_link[:3, :3].T @ np.array([0.0, 0.0, -STANDARD_GRAVITY * MASS_KG])
        centre = poses[:, :3, 3] + CENTRE_OF_MASS_M * poses[:, :3, 2]
        total = np.zeros((len(times), 6))
        # The weight is a force on the tool, so its sign is the other one.
        for force, at in ((forces, points), (np.broadcast_to(-down, forces.shape), centre)):
            own = (turn @ force[:, :, None])[:, :, 0]
            arm = (turn @ (at - origin)[:, :, None])[:, :, 0]
            total += np.concatenate([own, np.cross(arm, own)], axis=1)
        return total


def _smooth_step(share: FloatArray) -> FloatArray:
    return 0.5 - 0.5 * np.cos(np.pi * np.clip(share, 0.0, 1.0))


def _draw_part_pose(rng: np.random.Generator) -> FloatArray:
    """Draw the pose (4, 4) of a part in front of a robot, metres: turned by at most half a radian about each axis."""
    pose = np.eye(4)
    pose[:3, :3] = rotation_by(rng.uniform(-np.pi, np.pi) * np.array([0.0, 0.0, 1.0])) @ rotation_by(rng.uniform(-0.5, 0.5, 3))
    side, far = rng.uniform(-np.pi, np.pi), rng.uniform(NEAR_M, FAR_M)
    pose[:3, 3] = [far * np.cos(side), far * np.sin(side), rng.uniform(LOW_M, HIGH_M)]
    return pose


def _rotation_class() -> Any:
    # scipy is slow to import: only who simulates a tool pays.
    return import_module("scipy.spatial.transform").Rotation


def _vector_of(turn: FloatArray) -> FloatArray:
    vector: FloatArray = _rotation_class().from_matrix(turn).as_rotvec()
    return vector

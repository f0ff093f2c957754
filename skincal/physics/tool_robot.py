"""A cobot that holds the tip, with its force/torque sensor in the wrist or without one, and a part that stays still.

The arm knows the pose of its flange, and where the part is only roughly (`Effects.base`). Once skincal has found the part's
pose in the base of the flange's poses, the arm uses it (`locate_part`): its belief of the part moves, and nothing else.

At a landmark a person guides the tip by hand. They see where it is (`Effects.hand`), and the arm's belief does not matter.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np

from skincal.geometry import FloatArray, inverse_pose, rotations
from skincal.mesh.surface import Surface
from skincal.model.errors import InputError
from skincal.model.scene import Scene
from skincal.physics.effects import Effects
from skincal.physics.engine import PERIOD_S
from skincal.physics.layouts import ARM_BASE_TO_PART_M, TOOL_LENGTH_M, place_arm_and_part
from skincal.physics.mjcf import Joint, RigPlan
from skincal.physics.rig import RigLayout, SimulatedRobot
from skincal.robot.arm import TipCentre
from skincal.robot.target_lines import PokeTarget

TOOL_MASS_KG = 0.3
"""kg behind the sensor: a gripper's plate and the tip. Assumed."""
MOUNT_MASS_KG = 0.2
STIFF_TIP_N_PER_M = 1e5
"""N/m of a tip without bending."""
POSITION_ERROR_LENGTH_M = 0.3
"""m, over which the position error of a cobot changes. Assumed."""
DEFAULT_TIP_M = (0.0, 0.0, 0.12)
HAND_FOLLOWS_S = 0.2
"""s, time constant with which a hand follows its eye. Assumed."""


def tool_arm(scene: Scene, surface: Surface, effects: Effects) -> RigLayout:
    """Lay out a cobot in front of the part; its sensor lies where `flange` of the scene says, also if nothing streams it."""
    tool = scene.tool
    assert tool is not None, "the scene has a tool"
    flange_from_sensor = tool.tool_from_sensor if tool.has_sensor else np.eye(4)
    tip = np.array(DEFAULT_TIP_M) if tool.tip is None else tool.tip
    flange_from_wrist = np.eye(4)
    flange_from_wrist[:3, 3] = tip - [0.0, 0.0, TOOL_LENGTH_M]
    world_from_link, centre, chain, start, seeds = place_arm_and_part(surface)
    chain = [
        *chain,
        Joint(flange_from_sensor, None, mass=MOUNT_MASS_KG, trembles=True),
        Joint(np.eye(4), None, mass=TOOL_MASS_KG if effects.weight else 0.001, sensor_pose=np.eye(4)),
        Joint(inverse_pose(flange_from_sensor) @ flange_from_wrist, None),
    ]
    along = 1.0 / effects.bend if effects.bend else STIFF_TIP_N_PER_M
    plan = RigPlan(
        [Joint(world_from_link, None)], centre, chain, TOOL_LENGTH_M, False,
        tip_stiffness=along, tip_bending=along * TOOL_LENGTH_M**2,
    )  # fmt: skip
    return RigLayout(plan, start, seeds, lambda _: np.empty(0), lambda _: np.empty(0))


class ToolRobot(SimulatedRobot):
    """The cobot in the physics engine; parameters and errors as of `SimulatedRobot`."""

    _mistaken: FloatArray | None = None
    """(3,) float, m, part's frame: how far next to its place a person sees the tip; `None` while the arm aims."""

    def __init__(self, scene: Scene, surface: Surface, effects: Effects, seed: int) -> None:
        # The arm's own compliance is in `bend`.
        effects = replace(effects, sag=0.0)
        assert scene.tool is not None
        self._tool = scene.tool
        self._flange_from_sensor: FloatArray = scene.tool.tool_from_sensor if scene.tool.has_sensor else np.eye(4)
        self._world_from_base = np.eye(4)
        self._world_from_base[:3, 3] = 0.0, ARM_BASE_TO_PART_M, 0.0
        super().__init__(scene, surface, tool_arm(scene, surface, effects), effects, seed)
        errors = np.random.default_rng((seed, 1))
        self.engine.displace_tip(effects.tcp / np.sqrt(3.0) * errors.standard_normal(3))
        self._scale = 1.0 + effects.scale * errors.standard_normal()
        self._waves = errors.standard_normal((3, 3)) / POSITION_ERROR_LENGTH_M
        self._phases = errors.uniform(0.0, 2.0 * np.pi, 3)
        self._directions = rotations(errors.standard_normal((1, 3)))[0]
        self._hand_rng = errors
        self._guided_by = np.zeros(3)
        """(3,) float, m, part's frame: shift of the commands, so that the seen tip gets to its goal."""
        self._poses: deque[FloatArray] = deque(maxlen=1 + round(effects.late / PERIOD_S))
        self.add_listener(lambda: self._poses.append(self._read_pose()))

    def base_from_part(self) -> FloatArray:
        """Compute the true pose (4, 4) of the part in the base of the arm as its joints know it, metres."""
        return inverse_pose(self._world_from_base) @ self.engine.part_in_arm()

    def link_from_sensor(self) -> FloatArray:
        """Return link_from_sensor (4, 4) as the joints report it, with the part where the arm believes it."""
        return inverse_pose(self.engine.believed_part(self._angles)) @ self._world_from_flange() @ self._flange_from_sensor

    def _world_from_flange(self) -> FloatArray:
        return self.engine.believed_body("t5", self._angles)

    def _read_pose(self) -> FloatArray:
        """Compute the reported pose of the flange in the base, (7,) float: x y z, metres, and quaternion x y z w."""
        from scipy.spatial.transform import Rotation  # pyright: ignore[reportMissingTypeStubs] - slow to import

        pose = inverse_pose(self._world_from_base) @ self._world_from_flange()
        smooth = self.effects.warp * np.sqrt(2.0 / 3.0) * np.sin(self._waves @ pose[:3, 3] + self._phases)
        place = self._scale * pose[:3, 3] + self._directions @ smooth
        return np.concatenate([place, Rotation.from_matrix(pose[:3, :3]).as_quat()])

    def pose_record(self) -> FloatArray:
        """Return the reported pose (7,) of the flange, as late as its stream is."""
        return self._poses[0] if self._poses else self._read_pose()

    def prepare_for(self, target: PokeTarget) -> bool:
        """Let a person guide the tip to a known point; return whether one does."""
        self._mistaken = self.effects.hand * self._hand_rng.standard_normal(3) if target.known else None
        self._guided_by = np.zeros(3)
        return target.known

    def read_tip(self) -> TipCentre:
        """Read the tip in the part's frame as the arm believes it, or as a person sees it."""
        believed = super().read_tip()
        if self._mistaken is None:
            return believed
        return TipCentre(self.engine.tip_in_part()[0] + self._mistaken, believed.direction)

    def command(self, position: FloatArray, direction: FloatArray, speed_m_s: float) -> None:
        if self._mistaken is not None and self.engine.touch() is None:
            miss = super().read_tip().position - self.read_tip().position
            self._guided_by = self._guided_by + PERIOD_S / HAND_FOLLOWS_S * (miss - self._guided_by)
        super().command(position + (self._guided_by if self._mistaken is not None else 0.0), direction, speed_m_s)

    def locate_part(self, base_from_link: FloatArray) -> None:
        """Take the pose of the part in the base, (4, 4) metres, as skincal found it. The arm does not move by it.

        Raises InputError: it is no pose.
        """
        if base_from_link.shape != (4, 4) or not np.isfinite(base_from_link).all():
            raise InputError("the pose of the part is no pose; expected 4 x 4 numbers.")
        before = self.engine.believed_part(self._angles)
        self.engine.believe_part(self._world_from_base @ base_from_link)
        now_from_before = inverse_pose(self.engine.believed_part(self._angles)) @ before
        turn, shift = now_from_before[:3, :3], now_from_before[:3, 3]

        def carry_tip(tip: TipCentre) -> TipCentre:
            return TipCentre(turn @ tip.position + shift, turn @ tip.direction)

        is_same = self._goal is self._aim
        self._aim = carry_tip(self._aim)
        self._goal = self._aim if is_same else carry_tip(self._goal)
        self._servo = turn @ self._servo[0] + shift, turn @ self._servo[1]

    def _felt_by_part(self, wrench: FloatArray) -> FloatArray:
        """Give the wrench on the part: the sensor feels that on the tool."""
        return -wrench

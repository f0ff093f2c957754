"""The simulated robot with part, sensor and skin: an implementation of `PokingArm`."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from skincal.files.reference import truth_as_json
from skincal.geometry import FloatArray, crossed, inverse_pose, length_of, rotation_by
from skincal.mesh.surface import Surface
from skincal.model.errors import InputError
from skincal.model.scene import Scene
from skincal.physics.effects import BASE_TURN_PER_M, SENSOR_DELAY_S, Effects
from skincal.physics.engine import INVERSE_KINEMATICS_TOLERANCE_M, PERIOD_S, Engine
from skincal.physics.mjcf import TIP_RADIUS_M, RigPlan, write_mjcf
from skincal.physics.skin import Pads
from skincal.robot.arm import TipCentre, WrenchReading
from skincal.robot.target_lines import PokeTarget

if TYPE_CHECKING:
    from skincal.physics.vector_pads import VectorPadErrors, VectorPads

SENSOR_LAST_DIGIT_SD_N = 0.005
"""N, sd of one reading of a sensor without noise: its last digit. Readings that never change look like a frozen sensor."""
MOMENT_NOISE_OVER_FORCE_NOISE_M = 0.02
"""m, noise of a moment over that of a force: 0.005 N m for 0.25 N (FT45)."""
MAX_TURN_SPEED, MAX_TURN_ACCELERATION = 1.0, 3.0
"""rad/s and rad/s^2, largest with which the tip's direction turns."""
TIP_MAX_ACCELERATION_M_PER_S2 = 0.5
"""m/s^2, largest acceleration of the commanded tip."""
ACCELERATION_SHARE_WITH_CARRIED_PART = 0.3
"""Share of these limits for a part that the arm carries: it presses on its sensor when it accelerates."""
PART_MASS_ERROR_SD_SHARE = 0.02
"""sd of the part's mass as a moving robot knows it, to take its weight out of the readings. Assumed."""
OVERSHOOTING_SERVO_RAD_PER_S = 2.0 * np.pi * 4.0
"""rad/s, natural frequency of a servo that overshoots."""
RIG_SETTLING_TIME_S = 0.5
"""s until a new rig has come to rest."""


@dataclass(frozen=True, slots=True, eq=False)
class RigLayout:
    """A rig for a scene."""

    plan: RigPlan
    start: FloatArray
    """(joints,) float, radians: actuated joints at the start."""
    seeds: FloatArray
    """(n, joints) float, radians: other starts of the inverse kinematics."""
    reported: Callable[[FloatArray], FloatArray]
    """From the actuated joints (joints,) to the angles of the scene's arm, radians."""
    columns: Callable[[FloatArray], FloatArray]
    """From the actuated joints to a record of the joint stream, radians; empty without one."""
    skin_errors: VectorPadErrors | None = None
    """Of a skin of three axes; `None` for the usual ones."""


class SimulatedRobot:
    """A robot that pokes, in the physics engine.

    Parameters
    ----------
    surface : mesh of the part, on which the taxels lie
    seed : equal seeds give equal readings, to the last bit

    Raises InputError: MuJoCo is missing, or the scene does not say where its taxels are.
    """

    period_s = PERIOD_S
    tip_radius_m = TIP_RADIUS_M

    def __init__(self, scene: Scene, surface: Surface, layout: RigLayout, effects: Effects, seed: int) -> None:
        skin, sensor, base, tremble, self._frame_rng = np.random.default_rng(seed).spawn(5)
        self.scene, self.effects, self._layout = scene, effects, layout
        self.pads = make_pads(scene, surface, skin, layout.skin_errors)
        error = effects.base * base.standard_normal(3), rotation_by(effects.base * BASE_TURN_PER_M * base.standard_normal(3))
        self.engine = Engine(write_mjcf(layout.plan, effects), surface, layout.start, error)
        self._sensor_rng, self._tremble_rng = sensor, tremble
        names = [str(self.engine.model.joint(number).name) for number in range(int(self.engine.model.njnt))]
        chosen = [name for name in names if name.startswith("mount")] or [name for name in names if name.startswith("p")]
        self._trembling_dofs = [int(self.engine.model.joint(name).dofadr[0]) for name in chosen]
        self._angles = layout.start.copy()
        self._goal = self._aim = self.read_tip()
        self._speed, self._speeds = 0.0, (0.0, 0.0)
        self._servo = self._aim.position.copy(), np.zeros(3)
        self._filtered: FloatArray | None = None
        # A robot that turns its part compensates the weight, as the controllers of UR and of the iCub do.
        self.carries_part = layout.plan.part_is_actuated
        """The part moves with the arm against a fixed tip."""
        self._payload = (1.0 + PART_MASS_ERROR_SD_SHARE * sensor.standard_normal()) * self.carries_part
        self._share = ACCELERATION_SHARE_WITH_CARRIED_PART if self.carries_part else 1.0
        self._late: deque[FloatArray] = deque(maxlen=1 + (round(SENSOR_DELAY_S / PERIOD_S) if effects.low_pass else 0))
        self._wrench: WrenchReading | None = None
        self._pose: tuple[FloatArray, FloatArray] | None = None
        self.reading = np.zeros(6)
        """(6,) float, N and N m, sensor frame: newest reading of the sensor, in the scene's sign."""
        self._listeners: list[Callable[[], object]] = []
        self._tremble = 0.0
        self._settle()

    def _settle(self) -> None:
        """Let the rig come to rest; then scale the vibration to its size."""
        for _ in range(round(RIG_SETTLING_TIME_S / PERIOD_S)):
            self.engine.advance()
        if not self.effects.vibration:
            return
        self._tremble = 1.0
        read: list[FloatArray] = []
        for _ in range(round(4 * RIG_SETTLING_TIME_S / PERIOD_S)):
            self._shake()
            self.engine.advance()
            read.append(self.engine.sensor_wrench()[:3])
        forces: FloatArray = np.array(read[len(read) // 4 :])
        self._tremble = self.effects.vibration / float(np.sqrt(forces.var(axis=0).mean()))

    def _shake(self) -> None:
        model = self.engine.model
        torques: FloatArray = np.zeros(int(model.nv))
        dofs = self._trembling_dofs
        torques[dofs] = self._tremble * self._tremble_rng.standard_normal(len(dofs))
        self.engine.push_joints(torques)

    # ---- PokingArm

    @property
    def time_s(self) -> float:
        return self.engine.time_s

    def read_tip(self) -> TipCentre:
        return TipCentre(*self.engine.believed_tip(self._angles))

    def read_wrench(self) -> WrenchReading | None:
        return self._wrench

    def room_from_part(self) -> FloatArray:
        return self.engine.believed_part(self._angles) if self.carries_part else np.eye(4)

    def is_reachable(self, position: FloatArray, direction: FloatArray) -> bool:
        starts = [self._angles, self._layout.start, *self._layout.seeds]
        return any(self.engine.solve_angles(start, position, direction)[1] < INVERSE_KINEMATICS_TOLERANCE_M for start in starts)

    def command(self, position: FloatArray, direction: FloatArray, speed_m_s: float) -> None:
        if not (np.isfinite(position).all() and np.isfinite(direction).all() and length_of(direction) > 0.5):
            raise InputError(f"the arm was given {position} and {direction}; expected a position and a unit direction.")
        self._goal, self._speed = TipCentre(position, direction / length_of(direction)), speed_m_s

    def stop(self) -> None:
        self._goal, self._speeds = self._aim, (0.0, 0.0)

    def advance(self) -> None:
        self._follow_goal()
        self.engine.drive(self._angles)
        if self._tremble:
            self._shake()
        self.engine.advance()
        self._read_sensor()
        for listener in self._listeners:
            listener()

    def add_listener(self, listener: Callable[[], object]) -> None:
        """Call `listener` after each step."""
        self._listeners.append(listener)

    def _follow_goal(self) -> None:
        """Move the commanded tip towards the goal by one period, and solve the joints for it."""
        goal, aim = self._goal, self._aim
        if goal is not aim:
            self._aim, self._speeds = _moved_towards(aim, goal, self._speed, self._speeds, self._share)
        position = self._aim.position
        at, velocity = self._servo
        if self.effects.overshoot:
            # Overshoot = exp(-pi zeta / sqrt(1 - zeta^2)).
            log = np.log(self.effects.overshoot)
            damping = -log / np.hypot(np.pi, log)
            velocity = velocity + PERIOD_S * (
                OVERSHOOTING_SERVO_RAD_PER_S**2 * (position - at) - 2.0 * damping * OVERSHOOTING_SERVO_RAD_PER_S * velocity
            )
            position = at + PERIOD_S * velocity
        # A servo that overshoots stands still for a moment before it comes back.
        if self._aim is aim and max(length_of(position - at), length_of(position - aim.position)) < 2e-6:
            return
        self._servo = position, velocity
        self._angles = self.engine.solve_angles(self._angles, position, self._aim.direction, steps=4)[0]

    def _read_sensor(self) -> None:
        true, effects = self._felt_by_part(self.engine.sensor_wrench()), self.effects
        if effects.low_pass:
            share = 1.0 - np.exp(-2.0 * np.pi * effects.low_pass * PERIOD_S)
            before = true if self._filtered is None else self._filtered
            true = self._filtered = before + share * (true - before)
        self._late.append(true)
        sd = max(effects.noise, SENSOR_LAST_DIGIT_SD_N) * np.repeat([1.0, MOMENT_NOISE_OVER_FORCE_NOISE_M], 3)
        read = self._late[0] + sd * self._sensor_rng.standard_normal(6)
        if self._payload:
            read = read - self._payload * self.engine.believed_weight(self._angles)
        self.reading = self.scene.wrench_sign * read
        turn = self.link_from_sensor()[:3, :3]
        self._wrench = WrenchReading(self.time_s, turn @ read[:3], turn @ read[3:])

    def _felt_by_part(self, wrench: FloatArray) -> FloatArray:
        """Give the wrench (6,) on the part, sensor frame, from that on the sensor: the same if it is below the part."""
        return wrench

    # ---- for devices and tests

    def locate_part(self, base_from_link: FloatArray) -> None:
        """Take the pose of the part as skincal found it; an arm that pokes a part on its sensor knows it."""

    def prepare_for(self, target: PokeTarget) -> bool:  # noqa: ARG002 - of other arms
        """Prepare for a target, and return whether a person guides the tip; an arm that knows its part always drives."""
        return False

    def pose_record(self) -> FloatArray:
        """Return the reported pose (7,) of a tool that carries the tip; empty for a sensor below the part."""
        return np.empty(0)

    def link_from_sensor(self) -> FloatArray:
        """Return link_from_sensor (4, 4) as the joints report it."""
        arm = self.scene.arm
        if arm is None:
            return self.scene.sensor_pose
        angles = self._layout.reported(self._angles)
        if self._pose is None or not np.array_equal(self._pose[0], angles):
            self._pose = angles, arm.arm.link_from_sensor(angles)
        return self._pose[1]

    def joint_record(self) -> FloatArray:
        """Return a record of the joint stream, radians; empty without an arm."""
        return self._layout.columns(self._angles)

    def skin_frame(self) -> FloatArray:
        """Return a raw frame (width,) of the skin at the present contact."""
        return self.pads.frame(self.engine.touch(), self.effects.patch, self._frame_rng)

    def truth(self) -> dict[str, Any]:
        """Return the true taxels for `truth.json`."""
        pads = self.pads
        return truth_as_json(self.scene.link, pads.channels, pads.places, pads.normals, pads.axes)


def make_pads(
    scene: Scene, surface: Surface, rng: np.random.Generator, errors: VectorPadErrors | None = None
) -> Pads | VectorPads:
    """Make the pads of a skin: of one axis, or of three with `errors`, `None` for the usual ones. Raises as `Pads`."""
    if scene.skin.axes is None:
        return Pads(scene, surface, rng)
    from skincal.physics.vector_pads import VectorPads  # other scenes do without

    return VectorPads(scene, surface, scene.skin.axes, rng, errors)


def _moved_towards(
    aim: TipCentre, goal: TipCentre, speed: float, before: tuple[float, float], share: float
) -> tuple[TipCentre, tuple[float, float]]:
    """Move straight and turn on the way, for one period.

    Parameters
    ----------
    speed : m/s, largest
    before : speeds in the period before, m/s and rad/s
    share : of the other limits

    Returns
    -------
    The new pose of the tip and the new speeds.
    """
    way = goal.position - aim.position
    distance, cosine = length_of(way), float(np.clip(aim.direction @ goal.direction, -1.0, 1.0))
    angle = float(np.arccos(cosine))
    hasten, spin = share * TIP_MAX_ACCELERATION_M_PER_S2, share * MAX_TURN_ACCELERATION
    move = min(speed, before[0] + hasten * PERIOD_S, float(np.sqrt(2.0 * hasten * distance)))
    turn = min(share * MAX_TURN_SPEED, before[1] + spin * PERIOD_S, float(np.sqrt(2.0 * spin * angle)))
    # The slower of both sets the pace, so that they end together.
    periods = max(length / (pace * PERIOD_S) if length else 0.0 for length, pace in ((distance, move), (angle, turn)))
    if periods <= 1.0:
        return goal, (distance / PERIOD_S, angle / PERIOD_S)
    part = 1.0 / periods
    across = goal.direction - cosine * aim.direction
    size = length_of(across)
    if size < 1e-9:
        direction = aim.direction if cosine > 0 else goal.direction
    else:
        direction = np.cos(part * angle) * aim.direction + np.sin(part * angle) * across / size
    return TipCentre(aim.position + part * way, direction), (part * distance / PERIOD_S, part * angle / PERIOD_S)


def soft_axes(scene: Scene, angles: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
    """Find the axes of the scene's arm between sensor and part, by differences: axis (3,) and point (3,), link frame."""
    if scene.arm is None:
        return []
    found: list[tuple[FloatArray, FloatArray]] = []
    pose = scene.arm.arm.link_from_sensor(angles)
    small = 1e-5
    for turned in np.eye(len(angles)):
        change = (inverse_pose(scene.arm.arm.link_from_sensor(angles + small * turned)) - inverse_pose(pose)) / small
        twist = pose @ change
        spin = np.array([twist[2, 1], twist[0, 2], twist[1, 0]])
        if length_of(spin) > 0.5:
            found.append((spin / length_of(spin), crossed(spin, twist[:3, 3]) / (spin @ spin)))
    return found

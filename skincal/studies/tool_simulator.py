"""A cobot or a hand-held probe that pokes a still part, from first principles; it shares no code with the fit.

The tool has a ball at its end, and a force/torque sensor in the wrist or none. The part lies at a random pose in the base of
the tool's poses. With the true pose T of the flange in the base, a poke at the contact point c of the part with the outward
normal n presses the ball's centre to

    b = c + R n,   base_from_part b = T (tip - R z) + bend,   bend = k (I - z z') F,

R the ball's radius, z the tool's axis, `tip` the end of the ball on that axis, k the bending of the tool per newton across it,
and F the force on the tool. The sensor feels F at c, in its own frame. The reported pose differs from T by a scale, by a smooth
error of position over the workspace, by noise, and by its delay times the speed of the tool while it presses.

Foam covers the taxels: under the ball its outer face is pressed in by d (Winkler foundation, `independent_simulator`), so the
contact point is `foam` - d above the taxels. Skin, taxels, mesh and errors of the sensor are those of the second simulator.

Everything is drawn from a seed. Lengths are metres, forces newtons, angles radians.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from skincal.geometry import FloatArray, IntArray
from skincal.studies.independent_simulator import (
    DEGREE,
    FOAM_STIFFNESS_PA_PER_M,
    LANDMARK_CONE,
    LANDMARK_FORCES,
    MAX_ATTEMPTS_PER_TARGET,
    MM,
    SKIN_FORCES,
    Operator,
    Presses,
    RigModel,
    Sensor,
    Skin,
    SmoothSurface,
    dot,
    motions,
    sideways,
    taxels,
    turns,
    unit,
)

if TYPE_CHECKING:
    from skincal.model.scene import Scene

WORKSPACE_NEAR_M, WORKSPACE_FAR_M = 0.35, 0.65
"""m, distance of the part from the base: the middle of the reach of a small cobot (UR5e: 0.85 m)."""
POSITION_ERROR_LENGTH_M = 0.3
"""m, correlation length of a robot's position error: errors of link lengths and joint zeros change over this way."""
POSITION_ERROR_TURN = 0.6
"""Length of the difference of two unit directions over which that error changes: about 35 degrees of the wrist."""
ERROR_WAVES = 200
"""Waves of the smooth error."""
LANDMARK_TOUCHES = 3
"""Touches of each landmark, from different sides."""
STANDARD_GRAVITY = 9.81
SENSOR_OFFSET_N, SENSOR_OFFSET_N_M = 5.0, 0.3
"""sd of each component of what a sensor reads without load."""
NO_LANDMARK = -1


@dataclass(frozen=True, slots=True)
class ToolModel:
    """Errors of the arm that holds the tool, and its tool. The defaults are a cobot with a pointed tool.

    Sizes without a source are those of the project's plan for this rig: they were chosen, not measured.
    """

    rig: RigModel = field(default_factory=RigModel)
    """Skin, sensor, landmarks and operator. Its `pose_turn` and `pose_shift` are errors of the sensor's place on the flange."""
    has_sensor: bool = True
    scale: float = 0.002
    """sd of the relative error of all lengths (chosen): link lengths that differ from the controller's by as much."""
    position: float = 0.5 * MM
    """Rms length of the smooth position error (chosen). Robots miss commanded positions by 0.2 to 2 mm without compensation
    (industrialmonitordirect.com, "Robot accuracy vs repeatability", 2025)."""
    tip: float = 1.0 * MM
    """Rms length of the error of the tip in the scene. A four-point calibration of a pendant had residuals of 0.3 mm on
    average, 0.8 mm at most (forum.hokarob.com, "Iterative tool calibration"); by hand each touch errs by 0.5 to 1.5 mm."""
    pose_noise: float = 0.05 * MM
    """Rms length of the noise of a reported position, mean of a press. Repeatability of small cobots is 0.02 to 0.1 mm."""
    turn_noise: float = 0.02 * DEGREE
    """sd about each axis of the reported rotation."""
    delay_s: tuple[float, float] = (0.008, 0.040)
    """s, least and most (chosen): one period of 125 Hz, up to a driver with buffers."""
    creep: float = 0.5 * MM
    """m/s, sd along each axis of the tool's speed while it presses: foam yields."""
    bend: float = 0.05 * MM
    """m/N (chosen): a steel rod of 6 mm, 100 mm long, bends by 0.026 mm/N, the joints' gears by as much."""
    tip_radius: float = 2.0 * MM
    foam: float = 2.5 * MM
    """m, thickness of the foam on the taxels: 2 to 3 mm on iCub."""
    aside: float = 5 * DEGREE
    """sd in each direction of the angle between the tool's axis and the force: friction drags the tip."""
    mass: float = 0.5
    """kg, beyond the sensor."""
    sway: float = 0.1 * DEGREE
    """sd about each axis of the tool's turn between its tare and the press, which changes the direction of its weight."""


_WRIST_RIG = RigModel(
    quadratic=0.01, hysteresis=0.005, slow_force=0.1, landmarks=0.2 * MM, aim=0.3 * MM, mesh_bumps=0.2 * MM, gains=0.2,
    pads=0.1 * MM, thickness=0.0, scatter=0.3 * MM,
)  # fmt: skip
"""The second simulator's moderate rig. Landmarks are screws of a drawn part, to 0.2 mm; a robot aims at them to 0.3 mm."""
TOOL_RIGS: Mapping[str, ToolModel] = {
    "ideal": ToolModel(
        rig=RigModel(
            matrix=0.0, force_noise=0.0, pose_turn=0.0, pose_shift=0.0, aim=0.0, gains=0.0, scatter=0.0, landmarks=0.0,
        ),
        scale=0.0, position=0.0, tip=0.0, pose_noise=0.0, turn_noise=0.0, delay_s=(0.0, 0.0), creep=0.0, bend=0.0, aside=0.0,
        sway=0.0,
    ),
    "wrist": ToolModel(rig=_WRIST_RIG),
    "good_wrist": ToolModel(rig=replace(_WRIST_RIG, matrix=0.005)),
    "none": ToolModel(rig=_WRIST_RIG, has_sensor=False),
    "probe": ToolModel(
        rig=replace(_WRIST_RIG, aim=0.5 * MM, beside=2.5 * MM), has_sensor=False, scale=0.0, position=0.25 * MM, tip=0.3 * MM,
        pose_noise=0.3 * MM, turn_noise=0.1 * DEGREE, delay_s=(0.010, 0.040), creep=3 * MM, bend=0.0, sway=DEGREE,
    ),
}  # fmt: skip
"""By name.

`ideal` has no error. `wrist` has the paper's sensor: a force makes a moment of 7 mm times the force, in each of nine entries.
`good_wrist` has a quarter of that, as a sensor of 50 N and 10 N m with 1 % cross-talk. `probe` is a tracked probe held by hand:
0.3 mm (chosen; NDI accepts a Polaris Vicra with 0.25 mm rms over its volume, manual, appendix A), with the delay of an optical
tracker, 14 ms, and of its link. A hand moves by some mm/s.
"""


@dataclass(frozen=True, slots=True, eq=False)
class ToolSession:
    """n pokes of a tool on a still part as its devices report them, and the truth."""

    wrench: FloatArray
    """(n, 6) float, N and N m, tared, sensor frame: force on the part, about the sensor's origin."""
    rest_wrench: FloatArray
    """(n, 6) float, N and N m: the same before each touch, with the weight of the tool and the sensor's offset."""
    base_from_tool: FloatArray
    """(n, 4, 4) float, metres: reported pose of the flange."""
    tip: FloatArray
    """(3,) float, metres, tool frame: end of the tip as the scene has it."""
    tool_from_sensor: FloatArray
    """(4, 4) float, metres: pose of the sensor as the scene has it."""
    responses: FloatArray
    """(n, taxels) float: counts above the baseline; zero at landmarks."""
    landmark: IntArray
    """(n,) index of the landmark, `NO_LANDMARK` on the skin."""
    landmark_places: FloatArray
    """(landmarks, 3) float, metres, part frame: as the scene has them."""
    channels: IntArray
    """(taxels,) ascending."""
    places: FloatArray
    """(taxels, 3) float, metres, part frame: true positions."""
    vertices: FloatArray
    """(nv, 3) float, metres, part frame: mesh that the program gets."""
    base_from_part: FloatArray
    """(4, 4) float, metres: true pose of the part."""
    contact: FloatArray
    """(n, 3) float, metres, part frame: true points of contact."""
    delay_s: float
    """s, of the poses."""


class SmoothError:
    """A robot's position error, smooth over places and directions of its flange.

    Parameters
    ----------
    size : m, rms length
    rng : draws the waves
    """

    def __init__(self, size: float, rng: np.random.Generator) -> None:
        self._size = size / np.sqrt(3.0)
        lengths = np.repeat([POSITION_ERROR_LENGTH_M, POSITION_ERROR_TURN], [3, 6])
        self._waves = rng.standard_normal((3, ERROR_WAVES, 9)) / lengths
        self._phases = rng.uniform(0.0, 2 * np.pi, (3, ERROR_WAVES))

    def at(self, poses: FloatArray) -> FloatArray:
        """Compute the error (n, 3), metres, base, at true poses (n, 4, 4) of the flange."""
        features = np.concatenate([poses[:, :3, 3], poses[:, :3, 2], poses[:, :3, 0]], axis=1)
        waves = np.cos(np.einsum("awf,nf->naw", self._waves, features) + self._phases)
        # A cosine has a variance of one half.
        return self._size * np.sqrt(2.0 / ERROR_WAVES) * waves.sum(axis=2)


@dataclass(frozen=True, slots=True, eq=False)
class _Touches:
    """n touches by the tool, part frame."""

    contact: FloatArray
    """(n, 3) float, metres."""
    normal: FloatArray
    """(n, 3) float, unit, outward, at the contact."""
    force: FloatArray
    """(n, 3) float, N, on the part."""


def random_part_pose(rng: np.random.Generator) -> FloatArray:
    """Draw the pose (4, 4) of a part within reach of a robot, metres: any direction, any turn."""
    turn = rng.standard_normal(4)
    x, y, z, w = turn / np.linalg.norm(turn)
    pose = np.eye(4)
    pose[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    side, far = rng.uniform(-np.pi, np.pi), rng.uniform(WORKSPACE_NEAR_M, WORKSPACE_FAR_M)
    pose[:3, 3] = [far * np.cos(side), far * np.sin(side), rng.uniform(0.05, 0.4)]
    return pose


def _skin_touches(
    part: SmoothSurface, who: Operator, skin: Skin, model: ToolModel, targets: IntArray, rng: np.random.Generator
) -> tuple[_Touches, Presses]:
    """Press the foam near taxels, n touches: at the compressed face, under the ball's middle."""
    world, count = model.rig, len(targets)
    places = skin.places[targets]
    _, normals = part.nearest(places)
    feet, normals = part.nearest(places + world.beside * sideways(normals, rng))
    force = rng.uniform(*SKIN_FORCES, count)[:, None] * who.pushes(normals, world.cone, rng)
    load = -dot(force, normals)
    depth = np.sqrt(np.maximum(load, 0.0) / (np.pi * world.tip * FOAM_STIFFNESS_PA_PER_M))
    uneven = world.scatter * sideways(normals, rng)
    contact = feet + np.maximum(model.foam - depth, 0.0) * normals + uneven
    none = np.zeros_like(feet)
    presses = Presses(
        np.stack([feet, feet]), np.stack([contact, contact]), np.stack([force, none]), np.stack([load[:, 0], none[:, 0]])
    )
    return _Touches(contact, normals, force), presses


def simulate_tool_session(
    scene: Scene, vertices: FloatArray, triangles: IntArray, model: ToolModel, seed: int, counts: tuple[int, int] = (6, 168)
) -> ToolSession:
    """Touch the landmarks of a part, `LANDMARK_TOUCHES` times each, then poke its skin.

    Parameters
    ----------
    scene : with a layout, an anchor and a mesh; its sensor is not used
    vertices, triangles : (nv, 3) float, metres, and (nt, 3) int, outward: the true part
    counts : landmarks that are used, from the first one; pokes on the skin
    """
    mesh, mount, skin_rng, arm, sensor, hand, wrong, noise = np.random.default_rng([seed, 41]).spawn(8)
    world, landmarks = model.rig, counts[0]
    part = SmoothSurface(vertices, triangles)
    channels, places = taxels(scene, part, world, mount)
    skin = Skin(world, places, np.exp(world.gains * skin_rng.standard_normal(len(channels))))
    who = Operator(world, unit(part.nearest(places)[1].mean(axis=0)), hand)
    true_landmarks = np.array([each.place for each in scene.landmarks], dtype=np.float64).reshape(-1, 3)
    given = true_landmarks + world.landmarks * wrong.standard_normal(true_landmarks.shape)
    marks = np.tile(np.arange(landmarks), LANDMARK_TOUCHES)
    at_landmarks = _landmark_touches(part, who, true_landmarks[marks], hand)
    on_skin, responses = _answered_touches(scene, part, who, skin, (model, counts[1]), hand)
    touches = _Touches(
        *(np.concatenate(both) for both in zip(_parts(at_landmarks), _parts(on_skin), strict=True))  # landmarks first
    )
    arm_errors = _Arm(model, random_part_pose(arm), arm)
    true, reported = arm_errors.poses(touches, noise)
    wrench, rest = _read(arm_errors, touches, true, Sensor(world, sensor), noise)
    return ToolSession(
        wrench=wrench,
        rest_wrench=rest,
        base_from_tool=reported,
        tip=arm_errors.given_tip,
        tool_from_sensor=arm_errors.given_sensor,
        responses=np.concatenate([np.zeros((len(marks), len(channels))), responses]),
        landmark=np.concatenate([marks, np.full(len(responses), NO_LANDMARK)]),
        landmark_places=given,
        channels=channels,
        places=places,
        vertices=part.wrong(world, mesh),
        base_from_part=arm_errors.base_from_part,
        contact=touches.contact,
        delay_s=arm_errors.delay_s,
    )


def _parts(touches: _Touches) -> tuple[FloatArray, FloatArray, FloatArray]:
    return touches.contact, touches.normal, touches.force


def _landmark_touches(part: SmoothSurface, who: Operator, places: FloatArray, rng: np.random.Generator) -> _Touches:
    """Touch known points (n, 3) on hard ground."""
    if not len(places):
        return _Touches(places, places, places)
    _, normals = part.nearest(places)
    contact = places + who.world.aim * sideways(normals, rng)
    force = rng.uniform(*LANDMARK_FORCES, len(places))[:, None] * who.pushes(normals, LANDMARK_CONE, rng)
    return _Touches(contact, normals, force)


def _answered_touches(
    scene: Scene, part: SmoothSurface, who: Operator, skin: Skin, asked: tuple[ToolModel, int], rng: np.random.Generator
) -> tuple[_Touches, FloatArray]:
    """Poke the taxels in random rounds; a target that does not answer is tried again. Return touches and responses."""
    model, count = asked
    rounds = -(-count // len(skin.places))
    targets = np.concatenate([rng.permutation(len(skin.places)) for _ in range(rounds)])[:count]
    touches, presses = _skin_touches(part, who, skin, model, np.tile(targets, MAX_ATTEMPTS_PER_TARGET), rng)
    responses = skin.responses(presses, rng)
    answered = (responses > scene.contacts.response_min).sum(axis=1)
    good = ((answered > 0) & (answered <= scene.contacts.taxels_max)).reshape(MAX_ATTEMPTS_PER_TARGET, -1)
    rows = (good.argmax(axis=0) * count + np.arange(count))[good.any(axis=0)]
    return _Touches(*(each[rows] for each in _parts(touches))), responses[rows]


class _Arm:
    """The arm with its errors of a session.

    Parameters
    ----------
    model : sizes
    base_from_part : (4, 4) float, metres
    rng : draws what stays
    """

    def __init__(self, model: ToolModel, base_from_part: FloatArray, rng: np.random.Generator) -> None:
        self.model, self.base_from_part = model, base_from_part
        self.scale = model.scale * rng.standard_normal()
        self.smooth = SmoothError(model.position, rng)
        self.delay_s = float(rng.uniform(*model.delay_s))
        self.true_tip = np.append(rng.uniform(-3 * MM, 3 * MM, 2), rng.uniform(100 * MM, 140 * MM))
        self.given_tip = self.true_tip + model.tip / np.sqrt(3.0) * rng.standard_normal(3)
        place = motions(np.array([[0.0, 0.0, rng.uniform(-np.pi, np.pi)]]), np.array([[0.0, 0.0, rng.uniform(0.0, 40 * MM)]]))[
            0
        ]
        off = motions(model.rig.pose_turn * rng.standard_normal((1, 3)), model.rig.pose_shift * rng.standard_normal((1, 3)))[0]
        self.given_sensor, self.true_sensor = place, place @ off
        self.centre_of_mass = np.array([0.0, 0.0, 0.05])

    def poses(self, touches: _Touches, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Place the flange at touches: true and reported poses (n, 4, 4) in the base."""
        model, count = self.model, len(touches.force)
        turn, shift = self.base_from_part[:3, :3], self.base_from_part[:3, 3]
        force, normal = touches.force @ turn.T, touches.normal @ turn.T
        contact = touches.contact @ turn.T + shift
        axis = unit(force)
        axis = unit(axis + np.tan(model.aside) * sideways(axis, rng))
        side = unit(sideways(axis, rng))
        rotation = np.stack([side, np.cross(axis, side), axis], axis=2)
        centre = contact + model.tip_radius * normal
        across = -force + dot(force, axis) * axis
        # The tool bends: under load the ball is not where the unloaded tool would have it.
        to_centre = rotation @ (self.true_tip - [0.0, 0.0, model.tip_radius])
        true = np.tile(np.eye(4), (count, 1, 1))
        true[:, :3, :3], true[:, :3, 3] = rotation, centre - to_centre - model.bend * across
        reported = true.copy()
        noise = model.pose_noise / np.sqrt(3.0) * rng.standard_normal((count, 3))
        late = -self.delay_s * model.creep * rng.standard_normal((count, 3))
        reported[:, :3, 3] = (1.0 + self.scale) * true[:, :3, 3] + self.smooth.at(true) + noise + late
        reported[:, :3, :3] = turns(model.turn_noise * rng.standard_normal((count, 3))) @ rotation
        return true, reported


def _read(
    arm: _Arm, touches: _Touches, true: FloatArray, sensor: Sensor, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Read the tared wrenches (n, 6), as forces on the part, in the sensor's frame and about its origin, and those at rest."""
    poses = true @ arm.true_sensor
    turn, shift = arm.base_from_part[:3, :3], arm.base_from_part[:3, 3]
    back = poses[:, :3, :3].transpose(0, 2, 1)
    force = (back @ (touches.force @ turn.T)[:, :, None])[:, :, 0]
    at = (back @ (touches.contact @ turn.T + shift - poses[:, :3, 3])[:, :, None])[:, :, 0]
    on_part = np.concatenate([force, np.cross(at, force)], axis=1)
    # The sensor feels the opposite wrench; the weight of the tool has turned a little since its tare.
    weight = np.zeros((len(force), 3))
    weight[:, 2] = -STANDARD_GRAVITY * arm.model.mass
    swayed = turns(arm.model.sway * rng.standard_normal(weight.shape))
    hung = (back @ swayed @ weight[:, :, None])[:, :, 0]
    change = (back @ weight[:, :, None])[:, :, 0] - hung
    felt = -on_part + np.concatenate([change, np.cross(np.broadcast_to(arm.centre_of_mass, change.shape), change)], axis=1)
    tared = -sensor.read(felt, rng)
    at_rest = np.concatenate([hung, np.cross(np.broadcast_to(arm.centre_of_mass, hung.shape), hung)], axis=1)
    offset = np.repeat([SENSOR_OFFSET_N, SENSOR_OFFSET_N_M], 3) * rng.standard_normal(6)
    return tared, -(sensor.read(at_rest, rng) + offset)

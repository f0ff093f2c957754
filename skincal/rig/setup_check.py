"""Setup check: mistakes in a scene that the first pokes on the skin show, without any landmark.

The layout says where the taxels are, within a few millimetres. So the force axis of a poke passes the taxels that answer it,
and pushes from outside. If the pokes miss, each of the usual mistakes is tried: the sensor's axes, signs and units, a turned
flange, exchanged or inverted joints, the angle of a fixed joint, the other arm, a mirrored or turned layout, exchanged modules,
a shifted mesh. A mistake is named if it explains the pokes far better than the scene does.

The cost of a hypothesis is minus twice its log likelihood, after the best common shift of the skin. The miss of a poke has
Student's t distribution, so that slips count little. A push from inside costs as much as a large miss.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import TypeAlias

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry import Arm, FloatArray, IntArray, rotations
from skincal.mesh.lay import PlacedLayout, place_layout
from skincal.mesh.surface import Surface
from skincal.model.errors import InputError
from skincal.model.robot import RobotSpec
from skincal.model.scene import ArmSpec, Scene
from skincal.model.skin import Anchor, Layout
from skincal.model.urdf_chain import UrdfChain
from skincal.model.wrench_frames import FrameKind, WrenchFrame, rigid_points
from skincal.pokes import Pokes
from skincal.rig.channel_order import channel_orders, exchanged_order
from skincal.rig.scene_mistakes import Mistake, MistakeKind, sensor_mistakes

SETUP_CHECK_MIN_POKES = 6
SETUP_CHECK_MAX_POKES = 40
"""Pokes of a check: of more an even selection is used."""
TYPICAL_POKE_MISS_M = 0.007
"""m, scale of a poke's miss in each direction: hand, sensor, an ordinary rig's errors."""
STUDENT_T_DEGREES_OF_FREEDOM = 3.0
SENSOR_MOUNT_SHIFT_SD_M = 0.008
"""m, sd of the skin's shift from its plan, each direction: laid by hand, with an ordinary rig's errors."""
WRONG_MESH_ORIGIN_SHIFT_SD_M = 0.150
"""m, the same of a mesh with a wrong origin."""
COST_OF_PUSH_FROM_INSIDE = 6.0
"""Cost of a push from inside the part: one poke in twenty at an edge."""
NAME_MISTAKE_IF_COST_FALLS_BY = 12.0
"""A mistake is named if it is 400 times likelier than the scene. In 40 right sessions of a simulated iCub no mistake was
likelier at any number of pokes (6 to 40); half of the sessions had the errors of the paper's rig."""
NAME_OTHER_MISTAKES_WITHIN_COST_OF = 6.0
"""Other mistakes that are at most 20 times less likely are named, too."""
SCENE_FITS_BELOW_COST_PER_POKE = 0.7
"""Pokes that cost less fit the scene: nothing is tried."""
LAYOUT_FITS_BELOW_COST_PER_POKE = 3.0
"""Pokes that cost less lie within 10 mm of their taxels: the layout as a whole is right. An ordinary rig's cost at most 2.5."""
ANGLE_STEP, ANGLE_STEPS = 1e-4, 4
"""rad, of the numeric slopes; Gauss-Newton steps."""
MIN_TURN_DEG, TURN_STEP_DEG = 30, 15
"""Of a turned flange. Smaller turns look like the errors of an ordinary rig."""
SHIFT_FIT_STEPS = 10
OTHER_POINT_MIN_SHIFT_M = 0.010
"""m. A nearer point of the moments looks like a shift of the skin."""
TRIED_FIXED_ANGLE_STEP_DEG = 10
DOUBT_POINT_IF_AXES_ARE_NEARER_BY = 3.0
"""Factor: force axes that pass the sensor so much nearer if the moments are about the sensor make that likely."""
MIN_POKES_TO_DOUBT_POINT = 3
MIN_PAIRS_FOR_OWN_ERROR = 3
"""Pairs of pokes on one taxel that tell the rig's own errors."""
LAYOUT_FIT_MAX_SPACINGS, LAYOUT_FIT_MAX_OWN_ERRORS = 0.75, 3.0
"""Spacings of the layout, or own errors of the rig, that a change of the layout may leave (median)."""
TOOL_FIT_MAX_M = 0.020
"""m, median, that a change may leave if the sensor sits on the tool: wrong poses scatter the force axes by more."""
LONGEST_TOOL_M = 0.5
"""m from the sensor to the tip."""
PARALLEL_MAX_SINE = 0.05
"""Sine of the angle of two force axes below which they count as parallel."""


OF_LAYOUT = (MistakeKind.LAYOUT, MistakeKind.MODULES, MistakeKind.CHANNELS)
"""Mistakes of the layout."""

FORCE_BY_SIGN = ("force on the part", "reaction force")
"""Force that the sensor reports by [wrench] sign 1, and by -1."""


@dataclass(frozen=True, slots=True, eq=False)
class SetupDiagnosis:
    """Result of the setup check."""

    pokes: int
    miss: float
    """m, median distance of the pokes from the taxels that answered, as the scene says."""
    mistakes: tuple[Mistake, ...]
    """Likely mistakes, the likeliest first; empty if the pokes fit the scene."""
    of_touches: bool = False
    """Whether the tip of a tool shows them, at landmarks too, and no force axis."""


@dataclass(frozen=True, slots=True, eq=False)
class _TaxelEvidence:
    """n pokes on the skin under a hypothesis, and the taxels that answered them."""

    pokes: Pokes
    places: FloatArray
    """(n, 3) float, m: planned centre of the taxels that answered."""
    normals: FloatArray
    """(n, 3) float, unit, outward."""
    shift_sd: float = SENSOR_MOUNT_SHIFT_SD_M

    def with_pokes(self, **changes: FloatArray) -> _TaxelEvidence:
        """Change arrays of the pokes."""
        return replace(self, pokes=replace(self.pokes, **changes))


@dataclass(frozen=True, slots=True, eq=False)
class _Judged:
    cost: float
    reported: FloatArray
    """(n,) float, m: misses without a shift of the skin."""
    misses: FloatArray
    """(n,) float, m: misses with the best shift."""
    shift: FloatArray
    """(3,) float, m."""


def check_setup(
    contacts: Sequence[Contact],
    scene: Scene,
    laid: PlacedLayout | None,
    surface: Surface | None,
    frames: Sequence[WrenchFrame] = (),
) -> SetupDiagnosis | None:
    """Look for mistakes of a scene; `None` with too few pokes at planned taxels, without a plan, or without a sensor.

    Without a sensor a poke has no force axis: `touch_mistakes` judges its tip.

    Parameters
    ----------
    contacts : as the rig reported them
    laid : the scene's layout on the part
    frames : that the messages of the wrench name
    """
    if not scene.has_sensor:
        return None
    layout = scene.skin.layout
    planned = [] if laid is None else [each for each in contacts if np.isfinite(laid.places[each.strongest_channel]).all()]
    if laid is None or layout is None or len(planned) < SETUP_CHECK_MIN_POKES:
        return None
    count = min(len(planned), SETUP_CHECK_MAX_POKES)
    used = [planned[len(planned) * i // count] for i in range(count)]
    asked = _as_described(used, laid)
    (described,) = _judge([asked])
    limit = described.cost - NAME_MISTAKE_IF_COST_FALLS_BY
    found: list[tuple[float, Mistake]] = []
    if described.cost > SCENE_FITS_BELOW_COST_PER_POKE * count:
        exchange = _ChannelExchange(asked, used, laid)
        hypotheses = [*_hypotheses(asked, used, scene, exchange), *_wrench_frames(asked, scene, frames)]
        # To lay the layout takes up to a second.
        if described.cost > LAYOUT_FITS_BELOW_COST_PER_POKE * count:
            hypotheses += _layouts(asked, used, layout, scene.skin.anchor, surface)
        hypotheses += [(prior, mistake, exchange.in_order(order)) for prior, mistake, order in _orders(layout)]
        priors, mistakes, pokes = zip(*hypotheses, strict=True)
        found = [
            (prior + judged.cost, replace(mistake, miss=float(np.median(judged.misses)), shift=judged.shift))
            for prior, mistake, judged in zip(priors, mistakes, _judge(pokes), strict=True)
            if prior + judged.cost <= limit and _explains(mistake, judged, used, scene)
        ]
    best = min((cost for cost, _ in found), default=np.inf)
    likely = sorted(
        (each for each in found if each[0] <= min(limit, best + NAME_OTHER_MISTAKES_WITHIN_COST_OF)), key=lambda each: each[0]
    )
    miss = float(np.median(described.reported))
    unsettled = next((each for each in frames if not each.is_settled), None)
    if unsettled is not None and (likely or described.cost > LAYOUT_FITS_BELOW_COST_PER_POKE * count):
        return SetupDiagnosis(count, miss, (Mistake(MistakeKind.WRENCH_FRAME, miss, names=(unsettled.name,)),))
    if scene.tool is not None and not likely and described.cost > LAYOUT_FITS_BELOW_COST_PER_POKE * count:
        return SetupDiagnosis(count, miss, (Mistake(MistakeKind.TOOL_UNEXPLAINED, miss),))
    by_kind = {mistake.kind: mistake for _, mistake in reversed(likely)}
    kinds = dict.fromkeys(mistake.kind for _, mistake in likely)
    return SetupDiagnosis(count, miss, tuple(by_kind[kind] for kind in kinds))


def _orders(layout: Layout) -> list[tuple[float, Mistake, IntArray]]:
    """List other orders of the channels as mistakes with their prior costs."""
    found = list(channel_orders(layout))
    return [(_prior(len(found)), Mistake(MistakeKind.CHANNELS, names=(what, how)), order) for what, how, order in found]


class _ChannelExchange:
    """The planned places of pokes under other orders of the channels. A poke keeps its place if its channels keep theirs."""

    def __init__(self, asked: _TaxelEvidence, used: Sequence[Contact], laid: PlacedLayout) -> None:
        self._asked, self._used, self._laid = asked, used, laid
        self._channels = np.concatenate([each.channels for each in used])
        self._row_of = np.repeat(np.arange(len(used)), [len(each.channels) for each in used])

    def in_order(self, order: IntArray) -> _TaxelEvidence:
        """Give each channel the planned place of channel `order` (channels,)."""
        rows: list[int] = np.unique(self._row_of[order[self._channels] != self._channels]).tolist()
        if not rows:
            return self._asked
        places, normals = self._asked.places.copy(), self._asked.normals.copy()
        places[rows], normals[rows] = _planned([self._used[row] for row in rows], self._laid, order)
        return replace(self._asked, places=places, normals=normals)


def _explains(mistake: Mistake, judged: _Judged, used: Sequence[Contact], scene: Scene) -> bool:
    """Whether a change of the layout, or any change without an arm, leaves pokes as near as the rig's own errors.

    A wrong explanation that is nearer than the scene leaves taxels some spacings from their places. The own errors are the
    distances of force axes of pokes on one taxel. They are unknown without such pokes; then errors of an arm may be large.
    """
    layout = scene.skin.layout
    if layout is None or (scene.arm is not None and mistake.kind not in OF_LAYOUT):
        return True
    pokes, channels = Pokes.collect(used), [each.strongest_channel for each in used]
    pairs = [(one, other) for one, other in combinations(range(len(used)), 2) if channels[one] == channels[other]]
    apart = [_axis_distance(pokes[one], pokes[other]) for one, other in pairs]
    if scene.arm is not None and len(apart) < MIN_PAIRS_FOR_OWN_ERROR:
        return True
    own = float(np.median(apart)) if apart else 0.0
    most = max(LAYOUT_FIT_MAX_SPACINGS * layout.spacing, LAYOUT_FIT_MAX_OWN_ERRORS * own)
    most = most if scene.tool is None else min(most, TOOL_FIT_MAX_M)
    return float(np.median(judged.misses)) <= most


def _axis_distance(one: Pokes, other: Pokes) -> float:
    """Compute the smallest distance of two force axes, m."""
    between, across = other.axis_point - one.axis_point, np.cross(one.direction, other.direction)
    size = float(np.linalg.norm(across))
    if size < PARALLEL_MAX_SINE:
        return float(np.linalg.norm(np.cross(one.direction, between)))
    return abs(float(between @ across)) / size


def _as_described(used: Sequence[Contact], laid: PlacedLayout) -> _TaxelEvidence:
    places, normals = _planned(used, laid)
    return _TaxelEvidence(Pokes.collect(used), places, normals)


def _planned(used: Sequence[Contact], laid: PlacedLayout, order: IntArray | None = None) -> tuple[FloatArray, FloatArray]:
    """Compute the planned centre (n, 3) of the taxels that answered each poke, and the normal (n, 3) of the strongest one.

    Each channel has the planned place of channel `order` (channels,); `None` for its own.
    """
    order = np.arange(len(laid.places)) if order is None else order
    places: list[FloatArray] = []
    for each in used:
        answered = laid.places[order[each.channels]]
        known = np.isfinite(answered).all(axis=1)
        places.append(np.average(answered[known], axis=0, weights=each.responses[known]))
    return np.array(places), laid.normals[order[[each.strongest_channel for each in used]]]


def _judge(every: Sequence[_TaxelEvidence]) -> list[_Judged]:
    """Compute the cost of h hypotheses, each with the best common shift of the skin."""
    poses = np.array([each.pokes.link_from_sensor for each in every])
    forces, moments = np.array([each.pokes.force for each in every]), np.array([each.pokes.moment for each in every])
    force, moment = (np.einsum("hnij,hnj->hni", poses[..., :3, :3], values) for values in (forces, moments))
    squares = np.sum(force * force, axis=2, keepdims=True)
    push = force / np.sqrt(squares)
    axis_points = poses[..., :3, 3] + np.cross(force, moment) / squares
    across = np.eye(3) - push[..., :, None] * push[..., None, :]
    misses = np.einsum("hnij,hnj->hni", across, np.array([each.places for each in every]) - axis_points)
    shift_sds = np.array([each.shift_sd for each in every])
    outward = np.sum(push * np.array([each.normals for each in every]), axis=2) > 0
    best = np.full(len(every), np.inf)
    sizes, shifts = np.zeros(misses.shape[:2]), np.zeros((len(every), 3))
    # A large shift and some slips make two minima: one is found from no shift, the other from that of least squares.
    for by_least_squares in (False, True):
        weights = np.full(misses.shape[:2], 1.0 / TYPICAL_POKE_MISS_M**2)
        shift = np.zeros((len(every), 3))
        for step in range(SHIFT_FIT_STEPS):
            if step or not by_least_squares:
                off = misses + np.einsum("hnij,hj->hni", across, shift)
                squared = np.sum(off * off, axis=2)
                weights = np.asarray(
                    (STUDENT_T_DEGREES_OF_FREEDOM + 2.0) / (STUDENT_T_DEGREES_OF_FREEDOM * TYPICAL_POKE_MISS_M**2 + squared),
                    dtype=np.float64,
                )
            matrix = np.einsum("hn,hnij->hij", weights, across) + np.eye(3) / shift_sds[:, None, None] ** 2
            steps = np.asarray(np.linalg.solve(matrix, np.einsum("hn,hni->hi", weights, misses)[..., None]), dtype=np.float64)
            shift = -steps[..., 0]
        off = misses + np.einsum("hnij,hj->hni", across, shift)
        squared = np.sum(off * off, axis=2)
        cost = (STUDENT_T_DEGREES_OF_FREEDOM + 2.0) * np.sum(
            np.log1p(squared / (STUDENT_T_DEGREES_OF_FREEDOM * TYPICAL_POKE_MISS_M**2)), axis=1
        )
        cost += np.sum(shift * shift, axis=1) / shift_sds**2 + 6.0 * np.log(shift_sds / SENSOR_MOUNT_SHIFT_SD_M)
        cost += COST_OF_PUSH_FROM_INSIDE * np.sum(outward, axis=1)
        better = cost < best
        best = np.where(better, cost, best)
        sizes, shifts = np.where(better[:, None], np.sqrt(squared), sizes), np.where(better[:, None], shift, shifts)
    reported = np.linalg.norm(misses, axis=2)
    return [_Judged(*row) for row in zip(best.tolist(), reported, sizes, shifts, strict=True)]


_Hypotheses: TypeAlias = Iterator[tuple[float, Mistake, _TaxelEvidence]]
"""Prior cost, mistake, and the pokes if it is put right."""


def _prior(choices: int) -> float:
    """Compute the cost, -2 ln p, of one out of `choices` equally likely mistakes."""
    return 2.0 * math.log(choices)


def _hypotheses(asked: _TaxelEvidence, used: Sequence[Contact], scene: Scene, exchange: _ChannelExchange) -> _Hypotheses:
    assert scene.skin.layout is not None
    yield from _sensors(asked, scene)
    part_pose = () if scene.tool is None else ("base_from_link of [tool]",)
    if scene.tool is not None:
        from skincal.rig.tool_mistakes import tool_mistakes  # slow to import

        wrong = list(tool_mistakes(asked.pokes, scene.tool))
        yield from ((_prior(len(wrong)), mistake, asked.with_pokes(**changes)) for mistake, changes in wrong)
    yield 0.0, Mistake(MistakeKind.MESH_ORIGIN, names=part_pose), replace(asked, shift_sd=WRONG_MESH_ORIGIN_SHIFT_SD_M)
    if scene.arm is not None and (angles := _angles(used, scene.arm)) is not None:
        yield from _joints(asked, angles, scene.arm.arm)
        if scene.robot is not None:
            yield from _robots(asked, angles, scene.robot, scene.link)
    yield from _modules(used, scene.skin.layout, exchange)


def _sensors(asked: _TaxelEvidence, scene: Scene) -> _Hypotheses:
    """Try other axes and units of the sensor, and a turned flange."""
    for mistake in sensor_mistakes():
        if mistake.kind is MistakeKind.NONE:
            continue
        if scene.tool is not None and not _can_be_unit(mistake, asked.pokes):
            continue
        has_unit, has_axes = mistake.force_scale != mistake.moment_scale, mistake.kind is MistakeKind.AXES
        prior = (_prior(4) if has_unit else 0.0) + (_prior(2 if mistake.is_reaction else 47) if has_axes else 0.0)
        # A force axis has no unit of forces: only that of moments against it counts.
        scale, axes = mistake.moment_scale / mistake.force_scale, mistake.axes
        moment = scale * asked.pokes.moment @ axes.T
        if mistake.is_reaction:
            mistake = replace(mistake, names=FORCE_BY_SIGN[:: scene.wrench_sign])
        yield prior, mistake, asked.with_pokes(force=asked.pokes.force @ axes.T, moment=moment)
    for axis, degrees in product(range(3), range(MIN_TURN_DEG, 361 - MIN_TURN_DEG, TURN_STEP_DEG)):
        if degrees % 90:
            turn = rotations(np.radians(degrees) * np.eye(3)[axis][None])[0]
            wrench = asked.with_pokes(force=asked.pokes.force @ turn.T, moment=asked.pokes.moment @ turn.T)
            signed = float(degrees if degrees < 180 else degrees - 360)
            yield _prior(60), Mistake(MistakeKind.FLANGE, names=("xyz"[axis],), degrees=signed), wrench


def _can_be_unit(mistake: Mistake, pokes: Pokes) -> bool:
    """Tell whether moments in another unit may explain the pokes of a tool that carries the sensor.

    Its pushes are nearly along its axis. So moments are small, and without them every axis passes near the tip: moments in
    newton millimetres are those that no tool is long enough for.
    """
    if mistake.moment_scale == mistake.force_scale:
        return True
    lever = float(np.median(np.linalg.norm(pokes.moment, axis=1) / pokes.force_size))
    return mistake.moment_scale < mistake.force_scale and lever > LONGEST_TOOL_M


def distances_from_sensor(contacts: Sequence[Contact], frame: WrenchFrame) -> tuple[float, float]:
    """Compute how far the force axes pass from the sensor (median, m), as reported, and with moments about the sensor."""
    pokes = Pokes.collect(contacts)
    force, moment, squares = pokes.force, pokes.moment, np.sum(pokes.force * pokes.force, axis=1)
    about_sensor = moment - np.cross(frame.sensor_from_frame[:3, 3], force)
    far, near = (float(np.median(np.linalg.norm(np.cross(force, each), axis=1) / squares)) for each in (moment, about_sensor))
    return far, near


def is_point_doubted(contacts: Sequence[Contact], frame: WrenchFrame) -> bool:
    """Tell whether the pokes pass the sensor much nearer if the moments are about it than about the origin of their frame."""
    if frame.kind is not FrameKind.RIGID or frame.about or frame.taken_as or len(contacts) < MIN_POKES_TO_DOUBT_POINT:
        return False
    far, near = distances_from_sensor(contacts, frame)
    return far >= DOUBT_POINT_IF_AXES_ARE_NEARER_BY * near


def frame_in_doubt(frames: Sequence[WrenchFrame], contacts: Sequence[Contact]) -> str:
    """Return the name of the first frame whose readings or moments may be others than the scene's; empty without one.

    Small predicted errors prove nothing then.
    """
    return next((each.name for each in frames if not each.is_settled or is_point_doubted(contacts, each)), "")


def _wrench_frames(asked: _TaxelEvidence, scene: Scene, frames: Sequence[WrenchFrame]) -> _Hypotheses:
    """Try other points of the moments than the origin of the only frame, and that the messages name a wrong frame.

    Drivers that turn the axes alone keep the moments about the sensor, or about another point that is fixed to it.
    """
    if len(frames) != 1 or frames[0].kind is not FrameKind.RIGID or scene.robot is None or scene.tool is not None:
        return
    frame = frames[0]
    turn, point = frame.sensor_from_frame[:3, :3], frame.sensor_from_frame[:3, 3]
    others = {
        name: place
        for name, place in rigid_points(scene.robot).items()
        if np.linalg.norm(place - point) >= OTHER_POINT_MIN_SHIFT_M
    }
    for name, place in others.items():
        moment = asked.pokes.moment + np.cross(place - point, asked.pokes.force)
        prior = 0.0 if name == frame.sensor else _prior(len(others))
        yield prior, Mistake(MistakeKind.WRENCH_POINT, names=(frame.name, name)), asked.with_pokes(moment=moment)
    if frame.turn >= np.radians(MIN_TURN_DEG):
        moment = (asked.pokes.moment - np.cross(point, asked.pokes.force)) @ turn
        label = Mistake(MistakeKind.WRENCH_LABEL, names=(frame.name, frame.sensor))
        yield 0.0, label, asked.with_pokes(force=asked.pokes.force @ turn, moment=moment)


def _angles(used: Sequence[Contact], arm: ArmSpec) -> FloatArray | None:
    """Recover the reported angles (n, joints), rad, from the arm pose of each poke; `None` if its name does not hold them.

    A streamed pose's name has whole degrees, and stands for nearly equal ones: Gauss-Newton steps make them exact.
    """
    rows: list[FloatArray] = []
    for each in used:
        words = re.findall(r"(-?\d+) deg", each.pose)
        if each.pose not in arm.poses and len(words) != len(arm.arm.joints):
            return None
        angles = arm.poses[each.pose] if each.pose in arm.poses else np.radians(np.array(words, dtype=float))
        rows.append(_refined(angles, each.link_from_sensor, arm.arm))
    return np.array(rows)


def _refined(angles: FloatArray, pose: FloatArray, arm: Arm | UrdfChain) -> FloatArray:
    for _ in range(ANGLE_STEPS):
        now = arm.link_from_sensor(angles)
        steps = ANGLE_STEP * np.eye(len(angles))
        slopes = np.array([(arm.link_from_sensor(angles + step) - now).ravel() for step in steps]).T / ANGLE_STEP
        angles = angles + np.linalg.lstsq(slopes, (pose - now).ravel(), rcond=1e-6)[0]
    return angles


def _with_angles(asked: _TaxelEvidence, arm: Arm | UrdfChain, angles: FloatArray) -> _TaxelEvidence:
    return asked.with_pokes(link_from_sensor=np.array([arm.link_from_sensor(row) for row in angles]))


def _joints(asked: _TaxelEvidence, angles: FloatArray, arm: Arm | UrdfChain) -> _Hypotheses:
    """Try exchanged columns of the joint stream, other units, and inverted joints."""
    names = [joint.name for joint in arm.moving] if isinstance(arm, UrdfChain) else [f"column {each}" for each in arm.joints]
    count = len(names)
    for one, other in combinations(range(count), 2):
        swapped = angles.copy()
        swapped[:, [one, other]] = angles[:, [other, one]]
        mistake = Mistake(MistakeKind.JOINTS_EXCHANGED, names=(names[one], names[other]))
        yield _prior(count * (count - 1)), mistake, _with_angles(asked, arm, swapped)
    for name, right in (("radians", np.degrees(angles)), ("degrees", np.radians(angles))):
        yield _prior(2), Mistake(MistakeKind.JOINT_UNIT, names=(name,)), _with_angles(asked, arm, right)
    for column, name in enumerate(names):
        signs = np.where(np.arange(count) == column, -1.0, 1.0)
        yield _prior(8 * count), Mistake(MistakeKind.JOINT_SIGN, names=(name,)), _with_angles(asked, arm, signs * angles)


def _robots(asked: _TaxelEvidence, angles: FloatArray, robot: RobotSpec, link: str) -> _Hypotheses:
    """Try other angles of the fixed joints, and the other arm."""
    chain = robot.chain
    fixed = list(chain.fixed)
    for name, degrees in product(fixed, range(-180, 180, TRIED_FIXED_ANGLE_STEP_DEG)):
        tried = replace(chain, fixed={**chain.fixed, name: math.radians(degrees)})
        mistake = Mistake(MistakeKind.JOINT_ANGLE, names=(name,), degrees=float(degrees))
        yield _prior(36 * len(fixed)), mistake, _with_angles(asked, tried, angles)
    named = [other_side(name) for name in (robot.sensor, link)]
    try:
        columns = [other_side(name) or name for name in robot.columns]
        held = {other: angle for name, angle in chain.fixed.items() if (other := other_side(name))}
        other, _ = robot.urdf.chain(named[1] or link, named[0] or robot.sensor, columns, held, "")
    except InputError:
        return
    if not any(named) or other.joints != chain.joints:
        return
    moved = _with_angles(asked, other, angles)
    names = (named[0] or robot.sensor, named[1] or link)
    # The frames of both arms are mirrored in some way: by the signs of their axes.
    for signs in product((1.0, -1.0), repeat=3):
        mirrored = replace(moved, places=asked.places * signs, normals=asked.normals * signs)
        yield _prior(8), Mistake(MistakeKind.OTHER_ARM, names=names), mirrored


_SIDE_RE = re.compile(r"(?<![a-zA-Z])(left|right|l|r)(?![a-zA-Z])", re.IGNORECASE)
_OTHER_SIDE = {"left": "right", "right": "left", "l": "r", "r": "l"}


def other_side(name: str) -> str:
    """Exchange left and right in a name, such as `l_arm_ft`; empty if it names no side."""

    def exchange(match: re.Match[str]) -> str:
        word = match[0]
        other = _OTHER_SIDE[word.lower()]
        return other.upper() if word.isupper() else other.title() if word.istitle() else other

    other = _SIDE_RE.sub(exchange, name)
    return "" if other == name else other


def _modules(used: Sequence[Contact], layout: Layout, exchange: _ChannelExchange) -> _Hypotheses:
    """Try to exchange two modules with the same taxels, both of them touched."""
    touched = {int(layout.module_of[each.strongest_channel]) for each in used}
    pairs = [
        (one, other)
        for one, other in combinations(sorted(touched), 2)
        if np.array_equal(layout.modules[one].kind.pads, layout.modules[other].kind.pads, equal_nan=True)
    ]
    for one, other in pairs:
        first, second = (layout.modules[index] for index in (one, other))
        mistake = Mistake(MistakeKind.MODULES, names=(str(first.id), str(second.id)))
        yield _prior(len(pairs)), mistake, exchange.in_order(exchanged_order(layout, first.channels, second.channels))


def _layouts(
    asked: _TaxelEvidence, used: Sequence[Contact], layout: Layout, anchor: Anchor | None, surface: Surface | None
) -> _Hypotheses:
    """Try the layout mirrored, and turned by quarters, about its anchor."""
    if anchor is None:
        return
    y = np.cross(anchor.normal, anchor.x)
    for mirrored, quarters in product((False, True), range(4)):
        if not mirrored and not quarters:
            continue
        angle = quarters * math.pi / 2.0
        turned = replace(anchor, x=math.cos(angle) * anchor.x + math.sin(angle) * y)
        try:
            laid = place_layout(mirrored_layout(layout, anchor.at) if mirrored else layout, turned, surface)
        except InputError:
            continue
        if laid is None or not np.isfinite([laid.places[each.strongest_channel] for each in used]).all():
            continue
        centres, normals = _planned(used, laid)
        mistake = Mistake(MistakeKind.LAYOUT, mirrored=mirrored, degrees=90.0 * (quarters if quarters < 3 else -1))
        yield _prior(7), mistake, replace(asked, places=centres, normals=normals)


def mirrored_layout(layout: Layout, at: FloatArray) -> Layout:
    """Mirror a layout at the line through `at` (2,), m, along y: x becomes -x."""
    flip = np.array([-1.0, 1.0])
    modules = tuple(
        replace(each, place=at + flip * (each.place - at), angle=-each.angle, mirror=not each.mirror) for each in layout.modules
    )
    return layout.with_modules(modules)

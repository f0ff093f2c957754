"""Findings on the axes of a session: modules or taxels, mistakes of the scene, and the frame of each taxel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from skincal.axes.axis_checks import DeadAxis, find_dead_z
from skincal.axes.module_axes import PUSH_TOLERANCE, AxisFindings, ModulePlan, find_axes, share_of_own_errors
from skincal.axes.session_turns import SessionTurns, ShownTurn
from skincal.axes.taxel_frames import TaxelFrame, frames_of_taxels, turn_or_reason
from skincal.axes.turn_fit import AxisPokes
from skincal.contacts.value_order import OrderOfValues
from skincal.geometry import FloatArray, cross_matrix, fit_rotation, length_of
from skincal.model.skin import Layout, Module
from skincal.taxels.result import Estimate, Method

MIN_TAXELS_OF_PLAN = 3
"""Taxels with a position from which the turn of a module's plan is known."""


class AxisResults:
    """Findings on the axes of a session, by each method that places the plans of its modules.

    `turns` and `estimates` are of one snapshot, in one frame. Each answer is found once.
    """

    def __init__(
        self,
        turns: SessionTurns,
        layout: Layout | None,
        estimates: Mapping[Method, Sequence[Estimate]],
        order: OrderOfValues | None,
    ) -> None:
        self.turns = turns
        self._layout, self._estimates, self._order = layout, estimates, order
        self._findings: dict[Method, AxisFindings] = {}
        self._frames: dict[Method, dict[int, TaxelFrame]] = {}

    def findings(self, method: Method) -> AxisFindings:
        """Decide for each module, and name mistakes of the axes."""
        if method not in self._findings:
            plans = () if self._layout is None else module_plans(self._layout, self._estimates[method], self.turns.skin.pokes)
            modules = list(self.turns.modules.values())
            self._findings[method] = find_axes(self.turns.skin, plans, self._order, modules)
        return self._findings[method]

    def frames(self, method: Method) -> dict[int, TaxelFrame]:
        """Choose the frame of each taxel."""
        if method not in self._frames:
            channels = [estimate.channel for estimate in self._estimates[method]]
            dead_z = [each.channel for each in self.dead_z(method)]
            self._frames[method] = frames_of_taxels(self.turns, self.findings(method), channels, dead_z)
        return self._frames[method]

    def dead_z(self, method: Method) -> tuple[DeadAxis, ...]:
        """Find taxels whose z does not answer; none while the axes of the scene are wrong."""
        return () if self._order is None or self.findings(method).mistakes else find_dead_z(self._order.counts)

    def usable_turns(self, method: Method) -> dict[int, ShownTurn]:
        """Give the turn of each taxel that has one; not of a taxel with a dead axis, or with the readings of another taxel."""
        is_order_wrong = self.findings(method).is_value_order_wrong
        dead_z = [each.channel for each in self.dead_z(method)]
        found = {
            each.channel: turn_or_reason(self.turns, each.channel, is_order_wrong=is_order_wrong, dead_z=dead_z)
            for each in self._estimates[method]
        }
        return {channel: turn for channel, turn in found.items() if isinstance(turn, ShownTurn)}

    def poses(self, method: Method) -> dict[int, FloatArray]:
        """Give the pose (4, 4), metres, in the link, of each taxel whose position and turn are known."""
        frames, found = self.frames(method), dict[int, FloatArray]()
        for estimate in self._estimates[method]:
            rotation = frames[estimate.channel].rotation
            if estimate.position is not None and rotation is not None:
                pose = np.eye(4)
                pose[:3, :3], pose[:3, 3] = rotation, estimate.position
                found[estimate.channel] = pose
        return found


def module_plans(layout: Layout, estimates: Sequence[Estimate], pokes: Mapping[int, AxisPokes]) -> list[ModulePlan]:
    """Make the plan of each module, placed by the estimates of its taxels; `pokes` by channel."""
    by_channel = {each.channel: each for each in estimates if each.position is not None and each.normal is not None}
    return [place_plan(module, by_channel, pokes) for module in layout.modules]


def place_plan(module: Module, by_channel: Mapping[int, Estimate], pokes: Mapping[int, AxisPokes]) -> ModulePlan:
    """Fit the rotation from the plan of a module to its estimated taxels, with its error.

    The errors of the positions move the points that are fitted: all together by those that taxels share, and each by the
    others. These agree if one poke presses m taxels: the sum of m errors has up to m times the sum of their variances (Cauchy
    and Schwarz). By the modules method all n taxels have the errors of one pose.
    """
    channels = tuple(module.channels.tolist())
    known = [by_channel[channel] for channel in channels if channel in by_channel]
    places = {
        each.channel: (each.position, each.normal) for each in known if each.position is not None and each.normal is not None
    }
    placed = fit_plan(module, places)
    if placed is None:
        return ModulePlan(module.id, channels, None)
    rotation, points = placed
    pressed = [channel for channel in channels if channel in pokes]
    is_by_pose = known[0].method is Method.MODULES or not pressed
    agreeing = len(known) if is_by_pose else 1.0 / share_of_own_errors(pressed, pokes)
    return ModulePlan(module.id, channels, rotation, _turn_covariance(points @ rotation.T, known, agreeing))


def fit_plan(module: Module, places: Mapping[int, tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray] | None:
    """Fit the rotation (3, 3) from the plan of a module to the positions and normals of its taxels, by channel.

    Also gives the fitted points (n + 1, 3), m, in the plan, around their mean; the last one is that of the mean normal, as far
    out as the farthest taxel. `None` if they do not determine the rotation.
    """
    pads = module.kind.pads[~np.isnan(module.kind.pads[:, 0])] * np.array([-1.0 if module.mirror else 1.0, 1.0])
    known = [(pad, *places[channel]) for pad, channel in zip(pads, module.channels.tolist(), strict=True) if channel in places]
    if len(known) < MIN_TAXELS_OF_PLAN:
        return None
    flat = np.array([[*pad, 0.0] for pad, _, _ in known])
    found = np.array([place for _, place, _ in known])
    normal = np.array([each for _, _, each in known]).sum(axis=0)
    size = float(np.abs(flat - flat.mean(axis=0)).max())
    # The side is that of the normals.
    flat = np.concatenate([flat - flat.mean(axis=0), [[0.0, 0.0, size]]])
    found = np.concatenate([found - found.mean(axis=0), [size * normal / np.linalg.norm(normal)]])
    products = flat.T @ found
    if np.linalg.svd(products, compute_uv=False)[1] < 0.01 * size**2:
        return None
    return np.ascontiguousarray(fit_rotation(products).T), flat


def _normal_sd(estimate: Estimate) -> float:
    """Give the standard deviation of a normal, rad.

    The free method has the mean push for a normal, without an error: pokes lean, a hand's all to one side. A triangle's own
    normal is within the tolerance of the plan, and that of a module's pose has the error of the pose.
    """
    if estimate.normal_sd is not None:
        return estimate.normal_sd
    return PUSH_TOLERANCE if estimate.method is Method.FREE else 0.0


def _turn_covariance(points: FloatArray, estimates: Sequence[Estimate], agreeing: float) -> FloatArray:
    """Compute the covariance (3, 3), rad^2, of the turn of `points` (n + 1, 3), as `fit_plan` gives them, in the link frame.

    `agreeing` errors of positions are alike.
    """
    # Least squares of turn x point = error; the sum of S(p)'S(p) is |p|^2 I - p p'.
    information = np.sum(points**2) * np.eye(3) - points.T @ points
    slopes = list[FloatArray](np.linalg.inv(information) @ cross_matrix(points))
    own = np.zeros((3, 3))
    shared = list[FloatArray]()
    for slope, estimate in zip(slopes, estimates, strict=False):
        covariance, moved = estimate.covariance, estimate.moved
        assert covariance is not None
        if moved is not None:
            covariance = covariance - moved @ moved.T
            shared.append(slope @ moved)
        own += slope @ covariance @ slope.T
    of_normal = max(_normal_sd(estimate) for estimate in estimates) * length_of(points[-1]) * slopes[-1]
    of_shared = np.sum(shared, axis=0) if shared else np.zeros((3, 0))
    return agreeing * own + of_normal @ of_normal.T + of_shared @ of_shared.T

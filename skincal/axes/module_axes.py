"""One turn for a module, or one for each of its taxels, decided by the pokes; and plain mistakes of a scene's axes.

A maker may report the forces of all taxels in the axes of the module, or each in its own. Both are hypotheses on the same
pokes: a single turn R, or a turn for each taxel with any of them as likely before. Their odds are

    ln odds = w (E(all pokes of the module) - sum of E(pokes of a taxel)),                                    (4)

with E the logarithm of a fit's evidence (`TurnFit.log_evidence`): the fit that explains no more, with fewer unknowns, wins.
One poke presses many taxels, and they share its errors: w is the number of pokes over that of readings.
On a mesh the normals n of the skin are known. A taxel with a turn of its own then has z near n, and any turn about it, so

    E(pokes of a taxel) grows by ln(4 pi) + ln N(lean of z from n; 0, cov(z) + tolerance^2).                 (4a)

Without (4a) one turn with a small ratio of gains would explain a dome with a poke on each taxel: such readings are all along z.
The ratio is a property of the taxels, so modules are fitted with that of the taxels if it is better known.
The noise of few pokes is known to a factor of ten, and that of modules and of taxels is found from other misses. So the
evidence of each hypothesis is averaged over the sizes `NOISE_SIZES`. That of a shared turn has a limit.

Without a mesh, z of the taxels of a module lies near one unknown direction also if each has axes of its own: they are glued
side by side. So the taxels apart have, for each of the scales t of `TILT_SCALES` and for none with equal weights,

    sum of [E + ln(4 pi N(lean of z from the mean z; 0, t^2 + cov))] + ln(share of the sphere left for the mean z).      (4b)

Few pokes on a taxel make the odds of one turn too large: `SHARED_MARGIN` lowers them.

A module's plan has axes, too: x and y of the layout, and z out of the skin. A scene whose axes are right has R close to these
in the module's pose. If the axes of the readings are close to another signed permutation P of the plan's axes, a plain mistake
is there. Both are compared with the tolerance `PLAN_TOLERANCE` in each direction, since modules are glued by hand, and with
the error of the module's pose, which few pokes leave large:

    score(P) = w E(fit of P's hand) + ln N(turn of R from P; 0, V) + ln prior(P),
    V = cov(R)/w + cov(pose) + tolerance^2.                                                                      (5)

The P of the whole skin has the largest sum of scores, each module with at most `MAX_LOG_LOSS` below its own best: a single
turned module does not speak for the others. It is named if its odds over the scene's axes are certain, and if no other
mistake is nearly as likely.

On a curved part, taxels with axes of their own still lie near those of the plan. If they agree, the score of their module is
the sum of theirs, with the tolerance `CURVED_PLAN_TOLERANCE`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from itertools import permutations, product

import numpy as np

from skincal.axes.skin_turns import CERTAIN_LOG_ODDS, SkinTurns, Turn, find_noise, fit_group, joined
from skincal.axes.turn_fit import AxisNoise, AxisPokes, TurnFit
from skincal.contacts.value_order import OrderOfValues
from skincal.geometry import FloatArray, rotation_vector

PLAN_TOLERANCE = float(np.radians(8.0))
"""rad, standard deviation of a module's turn on the part from that of its plan: boards are glued by hand, and bend."""
CURVED_PLAN_TOLERANCE = float(np.radians(20.0))
"""rad, the same of a taxel with axes of its own, on a module that a curved part bends."""
MIN_JUDGED_TAXELS, MAX_JUDGED_TAXELS = 5, 8
"""Taxels of this module that are compared, those with the most pokes: 2 ms each. Fewer agree by chance."""
AGREEING_MIN_SHARE = 0.85
"""Share of these taxels that agree, from which they have the axes of the plan."""
LOG_PRIOR_OF_MISTAKE = float(np.log(0.01))
"""A wrong scene is rarer than a right one, by about this much for each kind of mistake."""
MAX_SHARED_NOISE = 0.12
"""rad, of a reading's direction. Taxels that share a turn scatter less: by 0.05 rad on the simulated skins."""
NOISE_SIZES = np.geomspace(0.004, MAX_SHARED_NOISE, 9)
"""rad, of a reading's direction, each as likely."""
MAX_LOG_LOSS = 15.0
"""Largest part of a module in the loss of a permutation of the whole skin."""
CLEAR_LOG_ODDS = float(np.log(5.0))
"""Of the named mistake over every other one."""
PUSH_TOLERANCE = float(np.radians(30.0))
"""rad, standard deviation of the mean push on a taxel from its z: pokes lean."""
TILT_SCALES = tuple(float(np.radians(angle)) for angle in (3.0, 15.0, 45.0))
"""rad, standard deviation of z of a module's taxels from their mean: a flat board, one that bends, a fingertip."""
SHARED_MARGIN = 1.5
"""Subtracted from the log odds of one turn for each taxel without a known turn in the plane. By Laplace's approximation twelve
taxels with random turns and one poke each have log odds of up to 17."""
SPREAD_MAX_NORMAL_SD = float(np.radians(5.0))
"""rad, of z of a taxel that shows the scatter in its module: two pokes give 1 degree, one gives 15 or more."""
MIN_SHARED_RATIO = 0.15
"""With a smaller ratio of gains all readings are along z, and any taxels seem to share a turn."""
AXIS_NAMES = ("x", "y", "z")
SIGNED_PERMUTATIONS: tuple[FloatArray, ...] = tuple(
    np.array([[sign[column] * (order[column] == row) for column in range(3)] for row in range(3)], dtype=np.float64)
    for order in permutations(range(3))
    for sign in product((1.0, -1.0), repeat=3)
)
"""The 48 ways to name three perpendicular axes, the usual one first; column k is the direction of axis k in the module."""


class AxisMistakeKind(Enum):
    """Plain mistake of the axes; the value is its key in JSON."""

    OPPOSITE = "opposite sign"
    """One axis has the opposite sign: x or y mirrored, or z negated."""
    EXCHANGED = "axes exchanged"
    """Two axes are exchanged."""
    TURNED = "turned"
    """The axes are turned about z by 90, 180 or 270 degrees."""
    OTHER = "other axes"
    """Another order with other signs."""
    ORDER = "order of values"
    """The values of a frame are grouped by axis and read as grouped by taxel, or the other way round."""


@dataclass(frozen=True, slots=True)
class AxisMistake:
    """A plain mistake of the axes of the whole skin, or of one module."""

    kind: AxisMistakeKind
    module: int | None
    """Id of the module; `None` for the whole skin."""
    axes: tuple[str, ...]
    """The axes that are opposite or exchanged; empty for others."""
    turn_deg: float
    """Turn about z, degrees, from the x axis of the plan to that of the readings; NaN for others."""
    log_odds: float
    """Natural logarithm of its odds over the scene's own axes."""
    directions: tuple[str, ...]
    """Axes of the module that x, y and z of the readings point along, such as `("y", "x", "z")`; `"-x"` for the opposite."""

    @property
    def is_mirrored(self) -> bool:
        """Whether these axes are left-handed, so that no rotation describes them."""
        places = [AXIS_NAMES.index(axis.lstrip("-")) for axis in self.directions]
        swaps = sum(first > second for at, first in enumerate(places) for second in places[at + 1 :])
        return (swaps + sum(axis.startswith("-") for axis in self.directions)) % 2 == 1


@dataclass(frozen=True, slots=True, eq=False)
class ModuleTurn:
    """The turn of a module's taxels together, and whether they share it."""

    id: int
    turn: Turn
    log_odds_shared: float
    """Natural logarithm of the odds of one turn over one for each taxel (4)."""
    taxels: int
    """Number of taxels with pokes."""
    spread: float
    """rad, root mean square angle between z of a taxel and of the module, without the part of noise; NaN while z of fewer than
    two taxels is known."""

    @property
    def is_shared(self) -> bool:
        """Whether one turn holds for all its taxels for certain."""
        return self.taxels > 1 and self.log_odds_shared > CERTAIN_LOG_ODDS

    @property
    def is_separate(self) -> bool:
        """Whether each taxel has a turn of its own for certain."""
        return self.taxels > 1 and self.log_odds_shared < -CERTAIN_LOG_ODDS


def has_shared_turn(module: ModuleTurn, log_odds_of_skin: float) -> bool:
    """Whether the taxels of a module have its turn: by their own pokes, or as those of the whole skin (`log_odds_shared`)."""
    return module.is_shared or (log_odds_of_skin > CERTAIN_LOG_ODDS and not module.is_separate)


@dataclass(frozen=True, slots=True, eq=False)
class ModulePlan:
    """What the layout says of a module."""

    id: int
    channels: tuple[int, ...]
    rotation: FloatArray | None
    """(3, 3) float: columns are x, y and the outward z of its plan in the link frame; `None` while its pose is unknown."""
    covariance: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    """(3, 3) float, rad^2, link frame: of the error of this rotation."""


@dataclass(frozen=True, slots=True, eq=False)
class AxisFindings:
    """What the pokes say of modules and of the scene's axes."""

    modules: tuple[ModuleTurn, ...]
    log_odds_shared: float
    """Natural logarithm of the odds that taxels report in the axes of their module, over all modules."""
    mistakes: tuple[AxisMistake, ...]

    @property
    def is_value_order_wrong(self) -> bool:
        """Whether the values of a frame have another order than the scene."""
        return any(mistake.kind is AxisMistakeKind.ORDER for mistake in self.mistakes)


def find_axes(
    turns: SkinTurns,
    plans: Sequence[ModulePlan],
    order: OrderOfValues | None = None,
    modules: Sequence[ModuleTurn] | None = None,
) -> AxisFindings:
    """Decide for each module, and name plain mistakes of the axes.

    Parameters
    ----------
    order : what the frames say of the order of values
    modules : the turns of modules by these pokes, if they are known already
    """
    modules = _module_turns(turns, plans) if modules is None else modules
    log_odds = float(sum(each.log_odds_shared for each in modules))
    if order is not None and order.is_open:
        # Readings of other taxels say nothing about axes.
        wrong = (AxisMistake(AxisMistakeKind.ORDER, None, (), float("nan"), order.log_odds_wrong, ()),)
        return AxisFindings(tuple(modules), log_odds, wrong if order.is_wrong else ())
    mistakes = _plan_mistakes(modules, {plan.id: plan for plan in plans}, turns)
    if not mistakes and all(plan.rotation is None for plan in plans):
        mistakes = _normal_mistakes(turns)
    return AxisFindings(tuple(modules), log_odds, mistakes)


def _module_turns(turns: SkinTurns, plans: Sequence[ModulePlan]) -> list[ModuleTurn]:
    own = {plan.id: tuple(channel for channel in plan.channels if channel in turns.taxels) for plan in plans}
    own = {number: channels for number, channels in own.items() if channels}
    pokes = {number: joined([turns.pokes[channel] for channel in channels]) for number, channels in own.items()}
    noise = find_module_noise(list(pokes.values()), turns.noise)
    return [module_turn(number, fit_group(own[number], pokes[number], noise), turns.taxels, {}) for number in own]


def find_module_noise(groups: Sequence[AxisPokes], of_taxels: AxisNoise) -> AxisNoise:
    """Find the noise of modules whose taxels share a turn, as `find_noise`, at most `MAX_SHARED_NOISE`.

    Without a limit the scatter of the taxels' normals would be noise. `of_taxels` is that of single taxels.
    """
    noise = find_noise(groups, of_taxels.force)
    if not groups:
        return noise
    if of_taxels.log_ratio_sd < noise.log_ratio_sd:
        noise = replace(noise, log_ratio=of_taxels.log_ratio, log_ratio_sd=of_taxels.log_ratio_sd)
    size = float(np.median(np.concatenate([np.linalg.norm(pokes.readings, axis=1) for pokes in groups])))
    return replace(noise, angle=min(noise.angle, MAX_SHARED_NOISE), reading=min(noise.reading, MAX_SHARED_NOISE * size))


def module_turn(number: int, turn: Turn, taxels: Mapping[int, Turn], normals: Mapping[int, FloatArray]) -> ModuleTurn:
    """Compare the turn of the module `number` with those of its `taxels`, by channel.

    `normals` (3,), unit, outward, are those of the skin, by channel, where a mesh gives them.
    """
    single = [taxels[channel] for channel in turn.channels]
    # One hand for all taxels: they are of one kind.
    together = max(_average_evidence([fit]) for fit in turn.fits)
    apart = max(_evidence_apart(single, hand, normals) for hand in range(2))
    # Readings that scatter more than those of any skin with a shared turn decide nothing.
    scatter = np.sqrt(np.median(np.concatenate([fit.variances for each in single for fit in each.fits])))
    odds = together - apart if len(single) > 1 and scatter < MAX_SHARED_NOISE else 0.0
    if odds > 0:
        hand = int(turn.log_odds_mirrored > 0)
        margin = SHARED_MARGIN * sum(not each.fits[hand].is_in_plane_known for each in single)
        odds = max(odds - margin, 0.0) if np.exp(turn.fits[hand].log_ratio) > MIN_SHARED_RATIO else 0.0
    odds *= turn.share / turn.fit.repeats
    return ModuleTurn(number, turn, odds, len(single), _spread(turn, single))


def _average_evidence(fits: Sequence[TurnFit]) -> float:
    """Compute the logarithm of the evidence of turns with the same noise, averaged over `NOISE_SIZES`."""
    size = float(np.sqrt(np.median(np.concatenate([fit.variances for fit in fits]))))
    evidences = np.sum([fit.log_evidences(NOISE_SIZES / size) for fit in fits], axis=0)
    return float(np.logaddexp.reduce(evidences) - np.log(len(NOISE_SIZES)))


def _log_factor_of_normal(turn: Turn, hand: int, normals: Mapping[int, FloatArray]) -> float:
    """Compute the logarithm of the factor (4a) from the normal of the skin."""
    fit = turn.fits[hand]
    local = fit.rotation.T @ normals[turn.channels[0]]
    # Turns about x and y that bring z to the normal.
    lean = (
        np.array([-local[1], local[0]])
        * float(np.arctan2(np.hypot(local[0], local[1]), local[2]))
        / max(float(np.hypot(local[0], local[1])), 1e-12)
    )
    variance = fit.covariance[:2, :2] + PLAN_TOLERANCE**2 * np.eye(2)
    return float(np.log(4.0 * np.pi) - np.log(2.0 * np.pi)) + _log_normal(lean, variance)


def _evidence_apart(single: Sequence[Turn], hand: int, normals: Mapping[int, FloatArray]) -> float:
    """Compute the logarithm of the evidence of one turn for each taxel, with z near the normals (4a) or one direction (4b)."""
    fits = [turn.fits[hand] for turn in single]
    evidence = _average_evidence(fits)
    if len(fits) < 2:
        return evidence
    if all(turn.channels[0] in normals for turn in single):
        return evidence + sum(_log_factor_of_normal(turn, hand, normals) for turn in single)
    leans, covariances = _leans_from_mean(fits)
    gains = [0.0]
    for scale in TILT_SCALES:
        variances = covariances + scale**2 * np.eye(2)
        _, log_dets = np.linalg.slogdet(variances)
        squares = np.einsum("ni,nij,nj->n", leans, np.linalg.inv(variances), leans)
        near = float(np.sum(np.log(2.0) - 0.5 * log_dets - 0.5 * squares))
        # The common direction is any, and known to this area.
        area = 2.0 * np.pi / float(np.sum(1.0 / np.sqrt(np.exp(log_dets))))
        gains.append(near + float(np.log(min(area / (4.0 * np.pi), 1.0))))
    return evidence + float(np.logaddexp.reduce(gains) - np.log(len(gains)))


def _leans_from_mean(fits: Sequence[TurnFit]) -> tuple[FloatArray, FloatArray]:
    """Compute the leans (n, 2), rad, of z of each fit to their mean, and their covariances (n, 2, 2), in the axes of each."""
    covariances = np.array([fit.covariance[:2, :2] for fit in fits])
    weights = 1.0 / (TILT_SCALES[0] ** 2 + 0.5 * np.trace(covariances, axis1=1, axis2=2))
    mean = weights @ np.array([fit.rotation[:, 2] for fit in fits])
    mean = mean / max(float(np.linalg.norm(mean)), 1e-12)
    local = np.array([fit.rotation.T @ mean for fit in fits])
    sine = np.hypot(local[:, 0], local[:, 1])
    stretch = np.arctan2(sine, local[:, 2]) / np.maximum(sine, 1e-12)
    return np.stack([-local[:, 1], local[:, 0]], axis=1) * stretch[:, None], covariances


def _spread(turn: Turn, single: Sequence[Turn]) -> float:
    """Estimate `ModuleTurn.spread` from taxels whose z is known, as DerSimonian and Laird (1986) do."""
    hand = int(turn.log_odds_mirrored > 0)
    z, fits = turn.fits[hand].rotation[:, 2], [each.fits[hand] for each in single]
    fits = [fit for fit in fits if fit.normal_sd < SPREAD_MAX_NORMAL_SD]
    if len(fits) < 2:
        return float("nan")
    angles = np.array([float(np.arccos(np.clip(fit.rotation[:, 2] @ z, -1.0, 1.0))) for fit in fits])
    # In each of two directions.
    weights = np.array([2.0 / float(np.trace(fit.covariance[:2, :2])) for fit in fits])
    excess = float(weights @ angles**2) - 2.0 * (len(fits) - 1)
    return float(np.sqrt(max(0.0, excess) / float(weights.sum() - weights @ weights / weights.sum())))


def _plan_mistakes(modules: Sequence[ModuleTurn], plans: Mapping[int, ModulePlan], turns: SkinTurns) -> tuple[AxisMistake, ...]:
    """Name mistakes against the plans of modules: the one of the whole skin, and those of single modules."""
    scores: dict[int, FloatArray] = {}
    for module in modules:
        plan = plans[module.id]
        if plan.rotation is None:
            continue
        if module.is_separate:
            own = _scores_of_taxels(module, plan, turns)
        else:
            own = score_permutations(module.turn, plan, share=module.turn.share)
        if own is not None:
            scores[module.id] = own
    if not scores:
        return ()
    losses = [np.maximum(own - own.max(), -MAX_LOG_LOSS) for own in scores.values()]
    common, log_odds = _likeliest(np.sum(losses, axis=0) + _LOG_PRIORS)
    mistakes: list[AxisMistake] = []
    if common != 0:
        mistakes.append(describe_permutation(SIGNED_PERMUTATIONS[common], None, log_odds))
    for number, own in scores.items():
        best, log_odds = _likeliest(own + np.where(np.arange(len(own)) == common, 0.0, _LOG_PRIORS), common)
        if best != common:
            mistakes.append(describe_permutation(SIGNED_PERMUTATIONS[best], number, log_odds))
    return tuple(mistakes)


def _likeliest(scores: FloatArray, usual: int = 0) -> tuple[int, float]:
    """Find the likeliest permutation by its scores (48,), with its log odds over the `usual` one.

    It is the usual one unless another one is certain, and more likely than each third one.
    """
    first, second = (int(each) for each in np.argsort(-scores, kind="stable")[:2])
    log_odds = float(scores[first] - scores[usual])
    is_clear = scores[first] - scores[second] > CLEAR_LOG_ODDS or second == usual
    return (first, log_odds) if first != usual and log_odds > CERTAIN_LOG_ODDS and is_clear else (usual, 0.0)


def share_of_own_errors(channels: Sequence[int], pokes: Mapping[int, AxisPokes]) -> float:
    """Compute the information of a reading if the taxels of a poke share its errors: pokes over readings."""
    numbers = np.concatenate([pokes[channel].pokes for channel in channels])
    return len(np.unique(numbers)) / len(numbers)


def _scores_of_taxels(module: ModuleTurn, plan: ModulePlan, turns: SkinTurns) -> FloatArray | None:
    """Sum the scores (48,) of taxels with axes of their own; `None` if they do not agree on a permutation."""
    taxels = turns.taxels
    judged = sorted(module.turn.channels, key=lambda channel: -taxels[channel].pokes)[:MAX_JUDGED_TAXELS]
    if len(judged) < MIN_JUDGED_TAXELS:
        return None
    each = np.array([score_permutations(taxels[channel], plan, CURVED_PLAN_TOLERANCE) for channel in judged])
    scores = share_of_own_errors(judged, turns.pokes) * each.sum(axis=0)
    agree = each[:, scores.argmax()] > each.max(axis=1) - CERTAIN_LOG_ODDS
    return scores if agree.mean() >= AGREEING_MIN_SHARE else None


def score_permutations(turn: Turn, plan: ModulePlan, tolerance: float = PLAN_TOLERANCE, share: float = 1.0) -> FloatArray:
    """Compute the scores (48,) of `SIGNED_PERMUTATIONS` of the axes of a placed plan, without priors (5).

    `tolerance` in rad; `share` is the information of a reading over that of readings with errors of their own.
    """
    assert plan.rotation is not None
    scores = np.empty(len(SIGNED_PERMUTATIONS))
    for place, permutation in enumerate(SIGNED_PERMUTATIONS):
        fit = turn.fits[int(np.linalg.det(permutation) < 0)]
        variance = fit.covariance[:3, :3] / share + tolerance**2 * np.eye(3)
        variance = variance + fit.rotation.T @ plan.covariance @ fit.rotation
        scores[place] = share * fit.log_evidence + _log_normal(_turn_between(plan.rotation @ permutation, fit), variance)
    return scores


def _turn_between(axes: FloatArray, fit: TurnFit) -> FloatArray:
    """Compute the turn (3,), rad, from `axes` (3, 3) to those of a fit, in the axes of the fit."""
    wanted = axes * np.array([1.0, -1.0, 1.0]) if np.linalg.det(axes) < 0 else axes
    return rotation_vector(wanted.T @ fit.rotation)


def _log_normal(miss: FloatArray, variance: FloatArray) -> float:
    _, log_det = np.linalg.slogdet(variance)
    return float(-0.5 * miss @ np.linalg.solve(variance, miss) - 0.5 * log_det)


def describe_permutation(permutation: FloatArray, module: int | None, log_odds: float) -> AxisMistake:
    """Name the mistake of axes that are a signed permutation (3, 3) of the plan's."""
    towards = [int(np.abs(permutation[:, column]).argmax()) for column in range(3)]
    signs = [float(permutation[towards[column], column]) for column in range(3)]
    directions = tuple(("-" if sign < 0 else "") + AXIS_NAMES[axis] for axis, sign in zip(towards, signs, strict=True))
    moved = [column for column in range(3) if towards[column] != column]
    opposite = [column for column in range(3) if signs[column] < 0]
    kind, axes, turn = AxisMistakeKind.OTHER, tuple[str, ...](), float("nan")
    if not moved and len(opposite) == 1:
        kind, axes = AxisMistakeKind.OPPOSITE, (AXIS_NAMES[opposite[0]],)
    elif permutation[2, 2] > 0 and np.linalg.det(permutation) > 0:
        kind, turn = AxisMistakeKind.TURNED, float(np.degrees(np.arctan2(permutation[1, 0], permutation[0, 0]))) % 360.0
    elif len(moved) == 2 and not opposite:
        kind, axes = AxisMistakeKind.EXCHANGED, tuple(AXIS_NAMES[column] for column in moved)
    return AxisMistake(kind, module, axes, turn, log_odds, directions)


def _normal_mistakes(turns: SkinTurns) -> tuple[AxisMistake, ...]:
    """Name mistakes that pushes alone show: z against the pushes, or mirrored axes."""
    inward, log_odds = 0, LOG_PRIOR_OF_MISTAKE
    for turn in turns.taxels.values():
        fit = turn.fits[int(turns.log_odds_mirrored > 0)]
        push = turns.pokes[turn.channels[0]].forces.sum(axis=0)
        angle = float(np.arccos(np.clip(fit.rotation[:, 2] @ push / np.linalg.norm(push), -1.0, 1.0)))
        variance = PUSH_TOLERANCE**2 + fit.normal_sd**2
        # z along the push in place of against it.
        log_odds += 0.5 * ((np.pi - angle) ** 2 - angle**2) / variance
        inward += angle < 0.5 * np.pi
    is_mirrored = turns.log_odds_mirrored + LOG_PRIOR_OF_MISTAKE > CERTAIN_LOG_ODDS
    is_hand_known = abs(turns.log_odds_mirrored) > CERTAIN_LOG_ODDS
    if log_odds > CERTAIN_LOG_ODDS and inward == len(turns.taxels) and is_hand_known:
        # Two axes of the opposite sign are no mirror.
        signs = [1.0, 1.0, -1.0] if turns.log_odds_mirrored >= 0 else [1.0, -1.0, -1.0]
        return (describe_permutation(np.diag(signs), None, float(log_odds)),)
    if is_mirrored and not inward:
        return (describe_permutation(np.diag([1.0, -1.0, 1.0]), None, turns.log_odds_mirrored + LOG_PRIOR_OF_MISTAKE),)
    return ()


def _log_prior(permutation: FloatArray) -> float:
    """Compute the logarithm of the prior of a permutation: one mistake is rare, two at once are rarer."""
    if np.array_equal(permutation, np.eye(3)):
        return 0.0
    is_single = describe_permutation(permutation, None, 0.0).kind is not AxisMistakeKind.OTHER
    return LOG_PRIOR_OF_MISTAKE * (1.0 if is_single else 1.5)


_LOG_PRIORS = np.array([_log_prior(permutation) for permutation in SIGNED_PERMUTATIONS])

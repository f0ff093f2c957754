"""Verdict on a session: whether it is finished, whether its predicted errors are believed, and which taxels are left.

**Held-out pokes.** One poke in six, more in a short session, is predicted from all the others. The poke counts for the
estimates, and is left out only for its prediction. The taxel that it answered most is solved without it. The poke's axis passes
that position at r = E (p - a), two numbers across the push, with the covariance E S E' + D: S is that of the taxel so solved
and D the poke's own noise. r' (E S E' + D)^-1 r is chi-square with two degrees of freedom, at most 5.99 for 95 of 100 pokes. D
contains the scatter of the contact points that the other pokes show beyond the scene's noise (`contact_scatter.py`). By the
modules method the touched module is solved without the poke (`predict_pokes`), and the axis passes the centre of the taxels
that answered.

This shows errors that the prediction does not contain: a wrong frame, a slipped sensor, a part that moved. Errors that shift
all pokes alike are shown by landmarks alone. Their pokes are held out, too, and their misses compared with the predicted ones
(`RigAnswer.ratio`). So errors are believed only if both agree.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import comb
from typing import TYPE_CHECKING

import numpy as np

from skincal.contacts.poke_columns import PokeColumns
from skincal.contacts.poke_counts import PokeCounts
from skincal.geometry import IntArray
from skincal.guide.contact_scatter import PokeMisses, learn_scatter
from skincal.guide.guidance import Guidance
from skincal.guide.moment import Moment
from skincal.guide.plan_check import find_taxels_off_plan
from skincal.guide.progress import MIN_CHECKED_POKES, GuideSettings, Need, Why, working_time
from skincal.model.scene import NoiseSettings
from skincal.model.skin import SkinKind
from skincal.modules.estimate import predict_pokes
from skincal.modules.pose import ModuleModel
from skincal.modules.pose_fit import Fitted, Touches, fit_modules_from_pokes
from skincal.rig.closing import Closing
from skincal.rig.correction_fit import LandmarkAgreement
from skincal.taxels.contact_table import Evidence
from skincal.taxels.exchanged import find_denied, find_exchanged
from skincal.taxels.noise import offset_square, row_precision
from skincal.taxels.predictions import PokePredictions
from skincal.taxels.result import FORCE_AXIS_MAX_MISS_M, POSITION_MAX_SD_M, Estimate, Method, State
from skincal.taxels.shared_errors import PredictedError, predicted_error
from skincal.taxels.solve import Solution, solve

if TYPE_CHECKING:
    from skincal.axes.module_axes import AxisFindings
    from skincal.mesh.surface import Surface
    from skincal.rig.part_scale import WrongScale

POKES_PER_HELD_OUT_POKE = 6
"""One poke in this many is held out."""
MIN_HELD_OUT_POKES = 20
"""In a short session more are held out, up to all: twice `MIN_CHECKED_POKES`, since some cannot be predicted. The choice
depends on the number of pokes alone, never on where they fell."""
CHI2_2DOF_QUANTILE_95 = 5.991
EXPECTED_SHARE_OUTSIDE_95_REGION = 0.05
"""Expected share of the pokes outside if the predicted errors are true."""
DISAGREE_IF_P_VALUE_BELOW = 0.01
"""Below this chance the number of pokes outside is no accident."""
AGREE_IF_P_VALUE_AT_LEAST = 0.1
"""With a smaller chance they are not said to agree: at most one true session in ten."""
MIN_OTHER_CONTACTS_TO_PREDICT = 2
"""Other contacts of its taxel that a prediction needs."""


@dataclass(frozen=True, slots=True)
class Check:
    """Number of held-out pokes, and of those inside their predicted regions."""

    checked: int
    inside: int
    off_plan: float | None = None
    """m, distance of taxels from the plan of their modules, sd in each direction; `None` without evidence of one."""

    @property
    def chance(self) -> float:
        """P-value: probability that as many or more are outside although the predicted errors are true."""
        outside, share = self.checked - self.inside, EXPECTED_SHARE_OUTSIDE_95_REGION
        # The binomial probability that fewer fall outside.
        below = sum(comb(self.checked, k) * share**k * (1.0 - share) ** (self.checked - k) for k in range(outside))
        # Rounding may bring the sum past 1.
        return max(0.0, 1.0 - below)

    @property
    def has_enough(self) -> bool:
        """Whether enough pokes were held out to call them in agreement."""
        return self.checked >= MIN_CHECKED_POKES

    @property
    def agrees(self) -> bool:
        """Whether the p-value is high and no taxel is off its plan: the held-out pokes agree with the predicted errors."""
        return self.off_plan is None and self.chance >= AGREE_IF_P_VALUE_AT_LEAST

    @property
    def believed(self) -> bool:
        """Whether the p-value is not too low: the held-out pokes do not contradict the predicted errors."""
        return self.chance >= DISAGREE_IF_P_VALUE_BELOW


def is_believed(check: Check, landmarks: LandmarkAgreement | None) -> bool:
    """Tell whether held-out pokes on the skin and landmarks both confirm the predicted errors.

    Landmarks alone show a shift of all taxels, and only if their own misses do not enlarge their predicted ones, and no robot
    drove to them by a pose of the part.
    """
    by_landmarks = landmarks is not None and landmarks.agrees and not landmarks.by_noise and not landmarks.driven
    return check.has_enough and check.agrees and by_landmarks


def held_out(pokes: PokeColumns) -> tuple[IntArray, IntArray]:
    """List numbers and strongest channels of the held-out contacts, by number."""
    counting = np.flatnonzero(pokes.counting)
    step = max(1, min(POKES_PER_HELD_OUT_POKE, len(counting) // MIN_HELD_OUT_POKES))
    rows = counting[step - 1 :: step]
    return pokes.numbers[rows], pokes.strongest[rows]


def check(
    moment: Moment,
    channels: Collection[int],
    method: Method,
    noise: NoiseSettings,
    surface: Surface | None,
    module_model: ModuleModel | None = None,
) -> Check:
    """Predict the held-out contacts of a moment from the others.

    Parameters
    ----------
    channels : taxels that are used
    surface : needed by the surface method
    module_model : needed by the modules method, whose search for the modules' poses begins at the moment's estimates
    """
    if method is Method.MODULES:
        return Check(0, 0) if module_model is None else _check_modules(moment, channels, noise, module_model)
    counting = moment.columns.counting
    numbers, strongest = moment.columns.numbers[counting], moment.columns.strongest[counting]
    used = np.isin(strongest, list(channels))
    answers, predicted = predict_by_taxels(moment, numbers[used], strongest[used], method, noise, surface)
    return _check_misses(moment, answers, predicted)


def predict_by_taxels(
    moment: Moment, pokes: IntArray, strongest: IntArray, method: Method, noise: NoiseSettings, surface: Surface | None
) -> tuple[Evidence, PokePredictions]:
    """Predict pokes (n,) at the taxels that answered them most, `strongest` (n,), from the other pokes of these.

    Returns
    -------
    Evidence of these taxels, and the predictions, without pokes whose taxel has too few others.
    """
    answers = moment.evidence(np.unique(strongest).tolist())
    cuts = _cuts(answers, list(zip(pokes.tolist(), strongest.tolist(), strict=True)))
    if not cuts:
        return answers, PokePredictions.none()
    # A taxel for each poke: a channel may be there twice, without another poke each time.
    sizes, others = np.array([len(others) for _, others in cuts]), np.concatenate([others for _, others in cuts])
    solution = solve(answers.select(others, np.arange(len(cuts)), sizes), [method], noise, surface)
    out = np.array([out for out, _ in cuts])
    return answers, _predictions(answers, out, solution, method, noise)


def _check_misses(moment: Moment, answers: Evidence, predicted: PokePredictions) -> Check:
    """Count the held-out pokes, and those inside; the scatter is learned from the other pokes."""
    known = np.flatnonzero(np.isfinite(predicted.misses).all(axis=1))
    rows = predicted.rows[known]
    every = PokeMisses(
        pokes=answers.pokes[rows],
        poses=answers.poses[rows],
        answers=_answer_counts(moment, answers.pokes[rows]),
        pairs=answers.pairs[rows],
        levers=predicted.levers[known],
        misses=predicted.misses[known],
        covariances=predicted.covariances[known],
        variances=np.trace(predicted.own[known], axis1=1, axis2=2) / 2.0,
    )
    out = np.isin(every.pokes, held_out(moment.columns)[0])
    scatter = learn_scatter(every.select(np.flatnonzero(~out)))
    squares = every.select(np.flatnonzero(out)).squares(scatter)
    return Check(len(squares), int((squares <= CHI2_2DOF_QUANTILE_95).sum()))


def _answer_counts(moment: Moment, pokes: IntArray) -> IntArray:
    """Look up (n,) the numbers of taxels that answered `pokes` (n,)."""
    return np.array([len(moment.contact(poke).channels) for poke in pokes.tolist()], dtype=np.int64)


def _check_modules(moment: Moment, channels: Collection[int], noise: NoiseSettings, model: ModuleModel) -> Check:
    """Predict the held-out contacts from the others of their module."""
    by_channel = {estimate.channel: estimate for estimate in moment.estimates.get(Method.MODULES, ())}
    answers, predicted, boards = predict_by_modules(moment, channels, by_channel, noise, model)
    checked = _check_misses(moment, answers, predicted)
    if boards is None:
        return checked
    touches, fitted, at = boards
    answered = _answer_counts(moment, answers.pokes[predicted.rows])
    return replace(checked, off_plan=find_taxels_off_plan(touches, fitted, model, at, predicted, answered))


def predict_by_modules(
    moment: Moment, channels: Collection[int], estimates: Mapping[int, Estimate], noise: NoiseSettings, model: ModuleModel
) -> tuple[Evidence, PokePredictions, tuple[Touches, Fitted, IntArray] | None]:
    """Predict pokes from the other pokes of their module.

    Parameters
    ----------
    channels : used taxels of some modules: all of a module, or none of it
    estimates : of the modules method by channel; the search for the modules' poses begins there

    Returns
    -------
    Evidence of these taxels; the predictions; and of boards their touches, their fit, and the (n,) touches that are predicted.
    """
    width, module_of = model.layout.width, model.layout.module_of
    answers = moment.evidence([channel for channel in channels if channel < width and module_of[channel] >= 0])
    pokes, of = np.unique(answers.pokes, return_inverse=True)
    responses = [moment.contact(poke).responses for poke in pokes.tolist()]
    totals = np.array([float(each.sum() / each.max()) for each in responses])[of]
    if model.layout.kind is SkinKind.SHEET:
        # Imported only for sheets.
        from skincal.modules.sheet_estimate import predict_sheet_pokes
        from skincal.modules.sheet_fit import fit_sheets

        return answers, predict_sheet_pokes(fit_sheets(answers, totals, model, noise, [estimates])), None
    fit = fit_modules_from_pokes(answers, totals, model, noise, [estimates])
    if fit is None:
        return answers, PokePredictions.none(), None
    touches, fitted = fit
    at = np.flatnonzero(fitted.misses[touches.of] <= FORCE_AXIS_MAX_MISS_M)
    return answers, predict_pokes(touches, fitted, at), (touches, fitted, at)


def _cuts(answers: Evidence, pairs: Sequence[tuple[int, int]]) -> list[tuple[int, list[int]]]:
    """List for each pair of poke and channel its own answer, and the answers of the taxel's other pokes."""
    row = {channel: i for i, channel in enumerate(answers.channels.tolist())}
    cuts: list[tuple[int, list[int]]] = []
    for poke, channel in pairs:
        if channel not in row:
            continue
        first, after = answers.starts[row[channel] : row[channel] + 2].tolist()
        out = answers.pokes[first:after].tolist().index(poke) + first
        others = [answer for answer in range(first, after) if answer != out]
        if len(others) >= MIN_OTHER_CONTACTS_TO_PREDICT:
            cuts.append((out, others))
    return cuts


def _predictions(answers: Evidence, out: IntArray, solution: Solution, method: Method, noise: NoiseSettings) -> PokePredictions:
    """Predict the pokes of the answers `out` (n,) by the taxels that were solved without them."""
    if method is Method.FREE and solution.has_free:
        places, known = solution.answer["solution"], solution.answer["free"]
        there = known["sd"] <= POSITION_MAX_SD_M
    elif solution.has_surface:
        places, known = solution.answer["point"], solution.answer["on_surface"]
        there = (solution.answer["triangle"] >= 0) & (known["sd"] <= POSITION_MAX_SD_M)
    else:
        raise ValueError(f"the {method.value} method was not solved")
    # Unknown values are 0 to keep the algebra finite, and become NaN below.
    covariances = np.where(there[:, None, None], known["covariance"], 0.0)
    places = np.where(there[:, None], places, 0.0)
    pairs, lever = answers.pairs[out], places - answers.sensors[out]
    precision = row_precision(pairs, lever, answers.forces[out], offset_square(answers.weights[out], noise), noise)
    own = np.asarray(np.linalg.inv(precision), dtype=np.float64)
    off = (pairs @ (places - answers.nearest[out])[:, :, None])[:, :, 0]
    total = pairs @ covariances @ pairs.transpose(0, 2, 1) + own
    return PokePredictions(out, lever, np.where(there[:, None], off, np.nan), total, own)


@dataclass(frozen=True, slots=True)
class Left:
    """A taxel that is not finished, and why."""

    channel: int
    why: Why
    needs: tuple[Need, ...]
    """None if it is not used."""
    refusal: str = ""
    """Why a robot cannot reach it; empty without a robot."""


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """Verdict on a session by one method."""

    method: Method
    enough: bool
    """Whether the guide requests no more pokes."""
    wanted: float
    """m, wanted predicted error."""
    done: int
    """Finished taxels, of `used`."""
    used: int
    left: tuple[Left, ...]
    """Taxels that are not finished, used or not, by channel."""
    check: Check
    landmarks: LandmarkAgreement | None
    """`None` from too few landmark pokes."""
    predicted: PredictedError | None
    """`None` without an estimate."""
    counts: PokeCounts
    seconds: float
    """s, of work, without pauses."""
    unchecked: float | None = None
    """m, rms shift of the taxels by rig errors that the prediction leaves out; `None` under a correction, whose uncertainty is
    in the prediction, or without an estimate."""
    closings: tuple[Closing, ...] = ()
    """Each closing check; the last one counts."""
    has_arm: bool = True
    """Whether the scene has joints of an arm."""
    has_tool: bool = False
    """Whether a tool pokes the part, whose poses are streamed."""
    touched_landmarks: int | None = None
    """Number of different landmarks that the tip of a tool touched; `None` in rigs whose sensor they check."""
    landmarks_left: int = 0
    """Number of landmark pokes that the guide still requests."""

    frame_in_doubt: str = ""
    """Frame that messages of the wrench name, if it is not settled what their readings mean; else empty."""
    off_mesh: float | None = None
    """m, median distance of a tool's touches from the mesh; `None` if it is within their error."""
    wrong_scale: WrongScale | None = None
    """Scale of the part's drawing that a tool's touches contradict; `None` if they agree with it."""
    states: Mapping[State, int] = field(default_factory=dict[State, int])
    """Number of used taxels in each state."""
    contradicted: tuple[int, ...] = ()
    """Channels with two or more own pokes that all contradict the place that their module gives them, and exchanged ones."""
    exchanged: tuple[tuple[int, int], ...] = ()
    """Pairs of channels that look exchanged."""
    axes: AxisFindings | None = None
    """Findings on the axes of taxels that measure three; `None` for one axis, or before the first reading."""

    @property
    def is_finished(self) -> bool:
        """Whether no more pokes are requested, a taxel is finished, and enough pokes test the result."""
        return self.enough and self.done > 0 and self.check.has_enough

    @property
    def tests_missing(self) -> int:
        """Number of test pokes that are still needed."""
        return max(0, MIN_CHECKED_POKES - self.check.checked)

    @property
    def doubted(self) -> bool:
        """Whether anything contradicts the predicted errors."""
        contradicted = not self.check.believed or self.check.off_plan is not None or bool(self.frame_in_doubt)
        contradicted |= bool(self.contradicted) or self.off_mesh is not None or self.is_value_order_wrong
        contradicted |= self.wrong_scale is not None
        return self.has_moved or contradicted or (self.landmarks is not None and not self.landmarks.agrees)

    @property
    def is_value_order_wrong(self) -> bool:
        """Whether the values of a frame have another order than the scene: then readings are those of other taxels."""
        return self.axes is not None and self.axes.is_value_order_wrong

    @property
    def has_moved(self) -> bool:
        """Whether the last closing check shows a movement."""
        return bool(self.closings) and self.closings[-1].has_moved

    @property
    def believed(self) -> bool:
        """Whether the predicted errors are confirmed (see `is_believed`)."""
        is_open = bool(self.frame_in_doubt) or bool(self.contradicted) or self.off_mesh is not None
        is_open |= self.is_value_order_wrong or self.wrong_scale is not None
        return not is_open and is_believed(self.check, self.landmarks)


def verdict_of(
    guidance: Guidance,
    moment: Moment,
    noise: NoiseSettings,
    surface: Surface | None,
    module_model: ModuleModel | None = None,
    landmarks: LandmarkAgreement | None = None,
) -> Verdict:
    """Judge a moment of a session by the method of its guidance.

    Parameters
    ----------
    surface, module_model : as for `check`
    landmarks : see `Verdict`
    """
    estimates, contacts = moment.estimates[guidance.method], moment.contacts
    state = {estimate.channel: estimate.state for estimate in estimates}
    used = [channel for channel in guidance.channels.tolist() if state.get(channel) is not State.DEAD]
    left = tuple(_unfinished_taxels(guidance, state))
    alone = moment.estimates.get(Method.SURFACE) or moment.estimates.get(Method.FREE, ())
    exchanged = find_exchanged(estimates, alone)
    return Verdict(
        method=guidance.method,
        enough=guidance.enough and bool(used),
        wanted=GuideSettings().wanted_by(guidance.method),
        done=len(used) - sum(taxel.why is not Why.DEAD for taxel in left),
        used=len(used),
        left=left,
        check=check(moment, used, guidance.method, noise, surface, module_model),
        landmarks=landmarks,
        landmarks_left=0 if guidance.landmark is None else guidance.landmark.pokes_left,
        predicted=predicted_error(estimates, moment.part_size),
        counts=moment.poke_counts,
        contradicted=find_denied(estimates, exchanged),
        exchanged=exchanged,
        states=Counter(state[channel] for channel in used if channel in state),
        seconds=working_time(*(np.array([getattr(contact, name) for contact in contacts]) for name in ("start_s", "end_s"))),
    )


def _unfinished_taxels(guidance: Guidance, state: Mapping[int, State]) -> Iterator[Left]:
    """Yield the taxels that are not finished, by channel."""
    for channel, needs in zip(guidance.channels.tolist(), guidance.needs, strict=True):
        if state.get(channel) is State.DEAD:
            yield Left(channel, Why.DEAD, ())
        elif needs:
            yield Left(channel, guidance.given_up.get(channel, Why.NOT_POKED_ENOUGH), needs)

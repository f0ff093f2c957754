"""How a session ends: what is known well enough, whether the predicted errors may be believed, what is not done and why.

*Believed.* One poke in six, of a short session more, is held out and predicted from all the others. It costs nothing: the poke
counts for the estimates, and is left out only where it is predicted. The taxel that answered it most is solved without it; the
poke's axis passes that place at r = E (p - a), two numbers across the push. Their covariance is E S E' + D, with S that of the
taxel so solved and D the poke's own noise (`knowledge.py`). r' (E S E' + D)^-1 r is a chi-squared of two degrees of freedom,
at most 5.99 in 95 of 100 pokes. To D the scatter of the contact points is added that the pokes which are not held out show
beyond the scene's noise (`contact_scatter.py`).

By the modules method the module that the poke touched is solved without it (`predicted_misses`), and the axis passes the
middle of the pads that answered; the rest is the same.

This shows errors that the prediction does not know of: a wrong frame, a slipped sensor, a part that moved. It does not show
what shifts all pokes alike: only landmarks do. Their pokes are held out, too, and their misses compared with what is predicted
for them (`RigAnswer.ratio`). So errors are believed only where both agree, and without landmarks it is said how far a rig may
be off before anything is known of it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import comb
from typing import TYPE_CHECKING

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray, IntArray
from skincal.guide.contact_scatter import PokeMisses, learn_scatter
from skincal.guide.guidance import Guidance
from skincal.guide.progress import GuideSettings, Need, Why, working_time
from skincal.model.scene import NoiseSettings
from skincal.modules.estimate import predicted_misses
from skincal.modules.pose import ModuleModel
from skincal.modules.pose_fit import fit_modules_from_pokes
from skincal.rig.closing import Closing
from skincal.rig.correction_fit import LandmarkAgreement
from skincal.taxels.contact_table import Evidence
from skincal.taxels.noise import offset_square, row_precision
from skincal.taxels.result import MISS_MAX, SD_MAX, Estimate, Method, State
from skincal.taxels.shared_errors import PredictedError, predicted_error
from skincal.taxels.solve import Solution, solve

if TYPE_CHECKING:
    from skincal.mesh.surface import Surface

ONE_IN = 6
"""One poke in so many is held out..."""
HELD_OUT = 20
"""...and more of them in a short session, down to every poke, so that there are so many: twice `TELLING`, since some cannot be
predicted. Which ones they are follows from the number of pokes alone, never from how they fell."""
INSIDE = 5.991
"""Chi-squared of two degrees of freedom that 95 % stay below."""
OUTSIDE_SHARE = 0.05
"""Share of the pokes that fall outside where the predicted errors are true."""
BELIEVED = 0.01
"""Chance below which so many outside are no accident."""
AGREED = 0.1
"""Chance below which they are not said to agree: at most one session in ten is denied it wrongly."""
TELLING = 10
"""Held-out pokes below which agreement says nothing: of five, none falls outside by chance in three sessions of four."""
OTHERS = 2
"""Other contacts of its taxel that a held-out poke needs: from fewer nothing is predicted."""


@dataclass(frozen=True, slots=True)
class Check:
    """How many held-out pokes fell where they were predicted."""

    checked: int
    inside: int

    @property
    def chance(self) -> float:
        """Chance, 0 to 1, that as many or more fall outside though the predicted errors are true."""
        outside, share = self.checked - self.inside, OUTSIDE_SHARE
        # The binomial probability that fewer fall outside.
        below = sum(comb(self.checked, k) * share**k * (1.0 - share) ** (self.checked - k) for k in range(outside))
        # Rounding may bring the sum past 1.
        return max(0.0, 1.0 - below)

    @property
    def tells(self) -> bool:
        """Whether there are enough of them to say anything."""
        return self.checked >= TELLING

    @property
    def agrees(self) -> bool:
        """Whether so many fall outside by chance often enough to say that they agree."""
        return self.chance >= AGREED

    @property
    def believed(self) -> bool:
        """Whether nothing speaks against the predicted errors."""
        return self.chance >= BELIEVED


def is_believed(check: Check, landmarks: LandmarkAgreement | None) -> bool:
    """Return whether what was held out speaks for the predicted errors: pokes on the skin, and landmarks.

    Landmarks alone show a shift that all taxels share, and only where their own misses do not widen what is predicted for them.
    """
    by_landmarks = landmarks is not None and landmarks.agrees and not landmarks.by_noise
    return check.tells and check.agrees and by_landmarks


def held_out(contacts: Sequence[Contact]) -> list[tuple[int, int]]:
    """Return number and strongest channel of the contacts that are held out, in the order of their numbers."""
    step = max(1, min(ONE_IN, len(contacts) // HELD_OUT))
    return [(contact.poke, contact.strongest_channel) for contact in contacts[step - 1 :: step]]


def check(
    contacts: Sequence[Contact],
    channels: Collection[int],
    evidence: Callable[[Collection[int]], Evidence],
    method: Method,
    noise: NoiseSettings,
    surface: Surface | None,
    module_model: ModuleModel | None = None,
    estimates: Sequence[Estimate] = (),
) -> Check:
    """Predict the held-out contacts from the others.

    Parameters
    ----------
    contacts : those that count, in the order of their numbers
    channels : taxels that are used
    evidence : gives what the contacts say of some channels
    surface : needed by the surface method
    module_model : needed by the modules method; without it nothing is predicted by that method
    estimates : of the modules method, where the search for the modules' poses begins
    """
    if method is Method.MODULES:
        return (
            Check(0, 0)
            if module_model is None
            else _check_modules(contacts, channels, evidence, noise, module_model, estimates)
        )
    used = set(channels)
    strongest = [(contact.poke, int(contact.channels[contact.responses.argmax()])) for contact in contacts]
    pairs = [(poke, channel) for poke, channel in strongest if channel in used]
    answers = evidence(sorted({channel for _, channel in pairs}))
    cuts = _cuts(answers, pairs)
    if not cuts:
        return Check(0, 0)
    solution = solve(_without(answers, [others for _, others in cuts]), [method], noise, surface)
    out = np.array([out for out, _ in cuts])
    return _check_misses(contacts, answers, out, *_misses(answers, out, solution, method, noise))


def _check_misses(
    contacts: Sequence[Contact],
    answers: Evidence,
    rows: IntArray,
    levers: FloatArray,
    misses: FloatArray,
    covariances: FloatArray,
    own: FloatArray,
) -> Check:
    """Count the held-out pokes, and those inside; the scatter is learned from the other pokes. `rows` are their answers."""
    known = np.flatnonzero(np.isfinite(misses).all(axis=1))
    counts = {contact.poke: len(contact.channels) for contact in contacts}
    pokes = answers.pokes[rows][known]
    every = PokeMisses(
        pokes=pokes,
        poses=answers.poses[rows][known],
        answers=np.array([counts[poke] for poke in pokes.tolist()], dtype=np.int64),
        pairs=answers.pairs[rows][known],
        levers=levers[known],
        misses=misses[known],
        covariances=covariances[known],
        variances=np.trace(own[known], axis1=1, axis2=2) / 2.0,
    )
    out = np.isin(pokes, [poke for poke, _ in held_out(contacts)])
    scatter = learn_scatter(every.select(np.flatnonzero(~out)))
    squares = every.select(np.flatnonzero(out)).squares(scatter)
    return Check(len(squares), int((squares <= INSIDE).sum()))


def _check_modules(
    contacts: Sequence[Contact],
    channels: Collection[int],
    evidence: Callable[[Collection[int]], Evidence],
    noise: NoiseSettings,
    model: ModuleModel,
    estimates: Sequence[Estimate],
) -> Check:
    """Predict the held-out contacts from the others of their module."""
    width, module_of = model.layout.width, model.layout.module_of
    answers = evidence([channel for channel in channels if channel < width and module_of[channel] >= 0])
    by_channel = {estimate.channel: estimate for estimate in estimates}
    weights = {contact.poke: float(contact.responses.sum() / contact.responses.max()) for contact in contacts}
    totals = np.array([weights[poke] for poke in answers.pokes.tolist()])
    fit = fit_modules_from_pokes(answers, totals, model, noise, [by_channel])
    if fit is None:
        return Check(0, 0)
    touches, fitted = fit
    at = np.flatnonzero(fitted.misses[touches.of] <= MISS_MAX)
    rows = touches.rows[at]
    levers = touches.contact_centres(fitted.pads)[0][at] - answers.sensors[rows]
    return _check_misses(contacts, answers, rows, levers, *predicted_misses(touches, fitted, noise, at))


def _cuts(answers: Evidence, pairs: Sequence[tuple[int, int]]) -> list[tuple[int, list[int]]]:
    """Return for each pair of poke and channel its own answer, and the answers of the taxel's other pokes."""
    row = {channel: i for i, channel in enumerate(answers.channels.tolist())}
    cuts: list[tuple[int, list[int]]] = []
    for poke, channel in pairs:
        if channel not in row:
            continue
        first, after = answers.starts[row[channel] : row[channel] + 2].tolist()
        out = answers.pokes[first:after].tolist().index(poke) + first
        others = [answer for answer in range(first, after) if answer != out]
        if len(others) >= OTHERS:
            cuts.append((out, others))
    return cuts


def _without(answers: Evidence, groups: Sequence[Sequence[int]]) -> Evidence:
    """Return evidence with a taxel for each group of answers: a channel may be there twice, without another poke each time."""
    sizes, every = np.array([len(group) for group in groups]), np.array([answer for group in groups for answer in group])
    return Evidence(
        channels=np.arange(len(groups)),
        starts=np.concatenate([[0], sizes.cumsum()]),
        taxels=np.arange(len(groups)).repeat(sizes),
        pokes=answers.pokes[every],
        poses=answers.poses[every],
        columns=np.ascontiguousarray(answers.columns[:, every]),
        weights=answers.weights[every],
        trust=np.ones(len(every)),
    )


def _misses(
    answers: Evidence, out: IntArray, solution: Solution, method: Method, noise: NoiseSettings
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Compute levers (n, 3), misses (n, 2), their covariances and the pokes' own (n, 2, 2); NaN where the taxel is unknown."""
    if method is Method.FREE and solution.has_free:
        places, known = solution.answer["solution"], solution.answer["free"]
        there = known["sd"] <= SD_MAX
    elif solution.has_surface:
        places, known = solution.answer["point"], solution.answer["on_surface"]
        there = (solution.answer["triangle"] >= 0) & (known["sd"] <= SD_MAX)
    else:
        raise ValueError(f"the {method.value} method was not solved")
    # What is not known is set to 0 to keep the algebra finite, and becomes NaN below.
    covariances = np.where(there[:, None, None], known["covariance"], 0.0)
    places = np.where(there[:, None], places, 0.0)
    pairs, lever = answers.pairs[out], places - answers.sensors[out]
    precision = row_precision(pairs, lever, answers.forces[out], offset_square(answers.weights[out], noise), noise)
    own = np.asarray(np.linalg.inv(precision), dtype=np.float64)
    off = (pairs @ (places - answers.nearest[out])[:, :, None])[:, :, 0]
    total = pairs @ covariances @ pairs.transpose(0, 2, 1) + own
    return lever, np.where(there[:, None], off, np.nan), total, own


@dataclass(frozen=True, slots=True)
class Left:
    """A taxel that is not done."""

    channel: int
    why: Why
    needs: tuple[Need, ...]
    """What it still needs; none where it is not used."""


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """What a session has come to by one method."""

    method: Method
    enough: bool
    """Whether nothing is asked for any more, of anything that there is."""
    wanted: float
    """m, the predicted error that was asked for."""
    done: int
    used: int
    """Taxels, without those that are not used."""
    left: tuple[Left, ...]
    """Those that are not done, used or not, by channel."""
    check: Check
    landmarks: LandmarkAgreement | None
    """None where too few were poked to say anything."""
    predicted: PredictedError | None
    """Of the taxels that are estimated; None where none is."""
    unchecked: float | None
    """m: by how much the rig's errors may move the taxels beside what is predicted, root mean square; None under a correction
    whose own uncertainty is in the prediction, or where no taxel is known."""
    pokes: int
    """Accepted, and not taken out."""
    seconds: float
    """s, from the first of these pokes to the end of the last, without pauses."""
    closings: tuple[Closing, ...] = ()
    """Whether anything moved since the session began, each time that was checked; the last one counts."""
    landmarks_left: int = 0
    """Pokes at landmarks that are still asked for."""

    @property
    def doubted(self) -> bool:
        """Whether anything speaks against the predicted errors."""
        return self.moved or not self.check.believed or (self.landmarks is not None and not self.landmarks.agrees)

    @property
    def moved(self) -> bool:
        """Whether something has moved by the last closing check."""
        return bool(self.closings) and self.closings[-1].moved

    @property
    def believed(self) -> bool:
        """Whether what was held out speaks for them (`is_believed`)."""
        return is_believed(self.check, self.landmarks)


def verdict_of(
    guidance: Guidance,
    estimates: Sequence[Estimate],
    contacts: Mapping[int, Contact],
    evidence: Callable[[Collection[int]], Evidence],
    noise: NoiseSettings,
    surface: Surface | None,
    settings: GuideSettings,
    module_model: ModuleModel | None = None,
    landmarks: LandmarkAgreement | None = None,
    unchecked: float | None = None,
) -> Verdict:
    """Return what a session has come to.

    Parameters
    ----------
    guidance : of this moment
    estimates : of its method
    contacts : those that count, by the number of their poke
    evidence : gives what the contacts say of some channels
    surface : needed by the surface method
    module_model : needed by the modules method, whose errors are not checked without it
    landmarks, unchecked : see `Verdict`
    """
    state = {estimate.channel: estimate.state for estimate in estimates}
    used = [channel for channel in guidance.channels.tolist() if state.get(channel) is not State.DEAD]
    left = tuple(_left(guidance, state))
    ordered = [contacts[poke] for poke in sorted(contacts)]
    return Verdict(
        method=guidance.method,
        enough=guidance.enough and bool(used),
        wanted=settings.wanted_by(guidance.method),
        done=len(used) - sum(taxel.why is not Why.DEAD for taxel in left),
        used=len(used),
        left=left,
        check=check(ordered, used, evidence, guidance.method, noise, surface, module_model, estimates),
        landmarks=landmarks,
        landmarks_left=0 if guidance.landmark is None else guidance.landmark.left,
        predicted=predicted_error(estimates),
        unchecked=unchecked,
        pokes=len(contacts),
        seconds=working_time(*(np.array([getattr(contact, name) for contact in ordered]) for name in ("start_s", "end_s"))),
    )


def _left(guidance: Guidance, state: Mapping[int, State]) -> Iterator[Left]:
    """Yield the taxels that are not done, by channel."""
    for channel, needs in zip(guidance.channels.tolist(), guidance.needs, strict=True):
        if state.get(channel) is State.DEAD:
            yield Left(channel, Why.DEAD, ())
        elif needs:
            yield Left(channel, guidance.given_up.get(channel, Why.NOT_POKED_ENOUGH), needs)

"""How far a session is: which taxels are done or given up, how many pokes are left, whose turn it is, how far a push may lean.

*Done and given up.* By what a taxel's contacts are like and by its predicted error; never by residuals, since those of
near-parallel axes agree and are wrong.

*Left.* Predicted from what each taxel still needs: good enough to plan a break by, and used for nothing else.

*Tilt.* A push that leans more than the friction angle slides more often than not, one that leans less seldom does. For each
angle that friction may have, the likelihood of the pokes so far is kept; its median, less a margin, is usable. What the
operator's hand manages lowers it further.

*Turns*, where pokes need no tilt but evenness: round by round, with a short way for the hand. An own poke is a turn, asked for
or not. A taxel that was asked for and missed is asked for once more in a round and no more often, so that a taxel out of reach
keeps none of the others waiting.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import FloatArray, IntArray
from skincal.taxels.result import Estimate, Method, State

BoolArray: TypeAlias = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class GuideSettings:
    """What the guide wants and what it takes for granted; SI units."""

    wanted: float = 0.003
    """m, predicted rms error at which a taxel may be done: a little over half of the 5 mm between taxels."""
    module_wanted: float = 0.0015
    """m, by the modules method, of the error that more pokes mend: a module's taxels are wrong together, so at 3 mm one in
    twelve is farther off than that."""
    module_patience: int = 36
    """Pokes of its module after which a taxel is given up that is not done: more than one needs, without a mesh, too."""
    bare_pokes: int = 32
    """Pokes that a module takes without a mesh, where only tilted pushes tell its depth: 30 to 35 on the flat patch."""
    module_pokes: int = 4
    """Pokes of a module's own, by the modules method: three places fix where it lies and how it is turned, and one is spare."""
    own_pokes: int = 3
    """Own pokes, in which the taxel answers most: what its neighbours' pokes say about it is off to their side."""
    diversity: float = float(np.radians(15.0))
    """rad, free method: below it depth is four times worse than the place across (1/sin)."""
    balance: float = 0.001
    """m: the middle of a taxel's contacts may lie this far beside it, and by the free method their places may pull its depth so
    far. Beyond, its estimate is off."""
    settled: float = 0.0005
    """m: how far the last poke of its own may have moved a taxel."""
    usable_tilt: float = float(np.radians(28.0))
    """rad, from the normal: a little less than the friction of a tip on foam holds."""
    tolerance: float = float(np.radians(10.0))
    """rad: a push within this of the wanted one is as asked; the hand's own error is 6 degrees (sd)."""
    sweep: float = 1.5
    """Pokes a taxel until the guide asks for own pokes: until then those between taxels say more, afterwards they pull
    neighbours together."""
    unanswered: int = 3
    """A taxel that was poked at so often and never answered is given up: it may be broken, or not where the layout says."""
    patience: int = 15
    """Own pokes after which a taxel is given up that is not done: twice as many as one needs in the mean."""
    unknown: float = 0.020
    """m, sd of a taxel's place in each direction before anything is known: keeps the error of a single axis finite."""
    poke_s: float = 2.0
    """s, for a poke where the hand is: measured on the simulated operator, whose habits are assumed."""
    hand_speed: float = 0.15
    """m/s, of the hand between taxels. Assumed: slow, as one aims."""

    def wanted_by(self, method: Method) -> float:
        """Return the predicted error, m, at which a taxel may be done by a method."""
        return self.module_wanted if method is Method.MODULES else self.wanted


class Need(Enum):
    """What a taxel still needs; the value says it in a few words."""

    POKES = "pokes of its own"
    ACCURACY = "a smaller predicted error"
    SIDES = "pokes from other sides"
    BALANCE = "pokes on its other half"
    DEPTH = "pokes that balance its depth"
    SETTLED = "one more poke, since the last one moved it"
    DECISION = "a poke that tells two places apart"


class Why(Enum):
    """Why a taxel is not done; the value says it in a few words."""

    DEAD = "not used"
    NEVER_FIRED = "never answered where it is expected"
    OUT_OF_REACH = "out of reach: every side of it was skipped"
    TILT = "the tilt that the hand manages does not spread its axes enough"
    AMBIGUOUS = "two places fit its pokes"
    NOT_CONVERGED = "many pokes were not enough"
    NOT_POKED_ENOUGH = "not poked enough yet"


@dataclass(frozen=True, slots=True)
class Facts:
    """What is known of one taxel beside its estimate; SI units."""

    own: int
    """Pokes of its own; by the modules method, of its module."""
    diversity: float
    beside: float
    pulled: float
    """In depth, outward, by where its contacts lie; free method."""
    moved: float


@dataclass(frozen=True, slots=True)
class Tried:
    """What was tried at one taxel, and what can be."""

    own: int
    often: bool
    """Enough pokes of its own, or of its module, were made in vain."""
    contacts: int
    """Pokes in which it answered."""
    unanswered: int
    """Pokes at it, while it was asked for, in which it did not answer."""
    shut: bool
    """Every side of it was skipped."""
    tilt: float
    """rad, the most that a push may lean now."""


def improvable_error(estimate: Estimate, skin: float) -> float:
    """Return the predicted rms error that more pokes on the skin make smaller, metres; infinite where nothing is known.

    Without what all taxels share, and along the normal without what is the mesh's, or the skin's thickness of sd `skin`.
    """
    if estimate.rms is None or estimate.covariance is None:
        return float("inf")
    own = estimate.covariance
    if estimate.moved is not None:
        own = own - estimate.moved @ estimate.moved.T
    rest = float(np.trace(own))
    if estimate.normal is not None:
        along = float(estimate.normal @ own @ estimate.normal)
        rest -= along if estimate.triangle is not None else min(along, skin**2)
    return float(np.sqrt(max(rest, 0.0)))


def find_needs(estimate: Estimate, facts: Facts, method: Method, settings: GuideSettings, skin: float) -> tuple[Need, ...]:
    """Return what a taxel still needs by a method; nothing where it is done or dead. `skin` is as for `improvable_error`."""
    if estimate.state is State.DEAD:
        return ()
    if method is Method.MODULES:
        few, wide = facts.own < settings.module_pokes, improvable_error(estimate, skin) > settings.module_wanted
        return tuple(need for need, is_missing in ((Need.POKES, few), (Need.ACCURACY, wide)) if is_missing)
    missing = {
        Need.POKES: facts.own < settings.own_pokes,
        Need.ACCURACY: estimate.rms is None or estimate.rms > settings.wanted,
        Need.SIDES: method is Method.FREE and facts.diversity < settings.diversity,
        Need.BALANCE: facts.beside > settings.balance,
        Need.DEPTH: method is Method.FREE and abs(facts.pulled) > settings.balance,
        Need.SETTLED: facts.own >= settings.own_pokes and not facts.moved <= settings.settled,
        Need.DECISION: estimate.rival is not None,
    }
    return tuple(need for need, is_missing in missing.items() if is_missing)


def give_up_reason(missing: tuple[Need, ...], tried: Tried, settings: GuideSettings) -> Why | None:
    """Return why a taxel that still needs something is no longer asked for; None where it is."""
    if not missing:
        return None
    if tried.shut:
        return Why.OUT_OF_REACH
    if tried.contacts == 0:
        return Why.NEVER_FIRED if tried.unanswered >= settings.unanswered else None
    if tried.often:
        return Why.AMBIGUOUS if Need.DECISION in missing else Why.NOT_CONVERGED
    # Axes that all lean by the same angle, evenly to all sides, have just that diversity; no others have more.
    if Need.SIDES in missing and tried.own >= settings.own_pokes and tried.tilt < settings.diversity:
        return Why.TILT
    return None


MOVES = {Method.FREE: 0.0070, Method.SURFACE: 0.0048}
"""m, sd of what a single poke says of a taxel in each direction, hand and sensor together: the n-th poke moves it by this over
n; by the free method depth above all. From guided sessions of the standard study, as `EXPECTED_HITS`."""
EXPECTED_HITS = 0.6
"""Share of the pokes that are own pokes of the taxel asked for; the others are a neighbour's, which may be done."""
BALANCING = 2
"""Own pokes that it takes to balance a taxel's contacts."""
PAUSE_S = 30.0
"""s. A longer time between two pokes is a pause, not work."""
RECENT = 20
"""Pokes whose pace counts."""


def pokes_left(
    method: Method,
    open_: BoolArray,
    own: IntArray,
    rms: FloatArray,
    beside: FloatArray,
    moved: FloatArray,
    settings: GuideSettings,
) -> int:
    """Return how many pokes it takes until nothing is open, by the free or the surface method.

    Parameters
    ----------
    open_ : (n,) which taxels need something and are not given up
    own : (n,) pokes of their own
    rms : (n,) float, metres, predicted; infinite while unknown
    beside : (n,) float, metres, of the middle of their contacts, or how far their depth is pulled if that is more
    moved : (n,) float, metres, by the last poke of their own
    """
    pokes, wanted = np.minimum(own, settings.patience - 1), settings.own_pokes - own
    # The variance falls as one over the pokes.
    error = np.where(np.isfinite(rms), rms, settings.wanted)
    exact = np.ceil(np.maximum(pokes, 1) * ((error / settings.wanted) ** 2 - 1.0))
    balance = np.where((beside > settings.balance) & (pokes > 0), BALANCING, 0)
    first = np.maximum.reduce([wanted, exact, balance, np.zeros(len(own))])
    unsettled = (first > 0) | ~(moved <= settings.settled)
    then = np.minimum(pokes + first, settings.patience).astype(np.int64)
    each = np.minimum(first + np.where(unsettled, _settling(MOVES[method], settings)[then], 0.0), settings.patience - pokes)
    share = float(open_.mean()) if len(open_) else 0.0
    # A poke that misses its taxel lands on a neighbour's, which is open with this share.
    return int(np.ceil(float(each[open_].sum()) / (EXPECTED_HITS + (1.0 - EXPECTED_HITS) * share)))


def count_module_pokes_left(
    open_: BoolArray, modules: IntArray, own: IntArray, rms: FloatArray, settings: GuideSettings
) -> int:
    """Return how many pokes it takes until no module is open, by the modules method.

    `modules` is (n,) of each taxel, `own` (n,) the pokes of its module, `rms` (n,) its `improvable_error`.
    """
    count = 0
    for module in np.unique(modules[open_]).tolist():
        taxels = modules == module
        pokes, error = int(own[taxels].max()), float(np.max(np.where(np.isfinite(rms[taxels]), rms[taxels], 0.0)))
        # The variance falls as one over the pokes.
        exact = int(np.ceil(max(pokes, 1) * ((error / settings.module_wanted) ** 2 - 1.0)))
        count += max(settings.module_pokes - pokes, min(exact, settings.module_patience - pokes), 1)
    return count


def count_pokes_from_start(method: Method, modules: IntArray, settings: GuideSettings, *, on_mesh: bool) -> int:
    """Return about how many pokes a method takes from the first to enough, by `pokes_left` and `count_module_pokes_left`.

    `modules` is (n,) of each taxel; `on_mesh` says that there is a mesh.
    """
    count = len(modules)
    every, nothing, unknown = np.ones(count, dtype=bool), np.zeros(count, dtype=np.int64), np.full(count, np.inf)
    if method is Method.MODULES and not on_mesh:
        return settings.bare_pokes * len(np.unique(modules))
    if method is Method.MODULES:
        return count_module_pokes_left(every, modules, nothing, unknown, settings)
    return pokes_left(method, every, nothing, unknown, np.zeros(count), unknown, settings)


def _settling(moves: float, settings: GuideSettings) -> FloatArray:
    """Return for each number of own pokes how many more it takes until one of them moves the taxel little enough.

    `moves` is one of `MOVES`.
    """
    after = np.zeros(settings.patience + 1)
    for pokes in range(settings.patience - 1, -1, -1):
        moved = moves / (pokes + 1)
        unsettled = float(np.exp(-0.5 * (settings.settled / moved) ** 2))
        after[pokes] = unsettled * (1.0 + after[pokes + 1])
    return after


def poke_interval(times: FloatArray) -> float | None:
    """Return the seconds between two pokes, the median of the last ones without pauses; None before the third poke.

    `times` is (n,), seconds, ascending: when each poke began.
    """
    steps = np.diff(times[-RECENT - 1 :])
    steps = steps[steps <= PAUSE_S]
    return float(np.median(steps)) if len(steps) >= 2 else None


def working_time(begins: FloatArray, ends: FloatArray) -> float:
    """Return how long it took, seconds, from the first poke's begin to the last one's end, without pauses."""
    if not len(begins):
        return 0.0
    waits = begins[1:] - ends[:-1]
    return float(np.sum(ends - begins) + np.sum(waits[waits <= PAUSE_S]))


ANGLES: FloatArray = np.radians(np.linspace(5.0, 60.0, 56))
"""rad, friction angles that are considered."""
PRIOR = (float(np.radians(40.0)), float(np.radians(10.0)))
"""rad, mean and sd before any poke: a rubber tip on foam. Assumed."""
SLIDES = (0.1, 0.5)
"""Chance that a poke slides that leans less, and more, than friction holds. Nearer to each other than friction alone would have
them, since hands slide for other reasons too: a single slide changes nothing."""
MARGIN = float(np.radians(5.0))
"""rad, between what is asked for and what just holds: somewhat less than a hand's error."""
STEP = float(np.radians(2.0))
"""rad: usable tilts are whole multiples, so that targets are not computed again with every poke."""
LEAST = float(np.radians(10.0))
"""rad: less is never asked for; a hand's own error is hardly smaller."""
MISSES = 2
"""So many misses in a row lower what is asked for."""
HITS = 4
"""So many hits in a row raise it again, by `RAISE`."""
RAISE = float(np.radians(4.0))
"""rad: two steps."""


class Tilt:
    """Learns from pokes how far a push may lean."""

    def __init__(self, settings: GuideSettings) -> None:
        self._settings = settings
        mean, sd = PRIOR
        self._log: FloatArray = -0.5 * ((ANGLES - mean) / sd) ** 2
        self._demand = settings.usable_tilt
        # rad, the tilts of the last pokes, as long as each was far less than asked for.
        self._short: list[float] = []
        self._hits = 0

    @property
    def friction(self) -> float:
        """The tilt, rad, that friction holds, as likely as not."""
        # The median over the angles; the largest is taken out first, so that not all exponentials underflow.
        likely = np.exp(self._log - self._log.max()).cumsum()
        return float(ANGLES[int((likely >= likely[-1] / 2.0).argmax())])

    @property
    def usable(self) -> float:
        """The most that is asked for, rad."""
        least = min(self._settings.usable_tilt, self._demand, self.friction - MARGIN)
        if least >= self._settings.usable_tilt:
            return self._settings.usable_tilt
        # A rounding error below a whole step is that step.
        return max(LEAST, STEP * float(np.floor(least / STEP + 1e-9)))

    def poked(self, tilts: FloatArray, *, slid: bool, taken_out: bool = False) -> None:
        """Count pokes that leaned `tilts`, (n,) rad, from the normal, NaN where that is not known; or take them out again."""
        more, less = (SLIDES[1], SLIDES[0]) if slid else (1.0 - SLIDES[1], 1.0 - SLIDES[0])
        known: FloatArray = tilts[np.isfinite(tilts)]
        # For each angle: how many of the pokes leaned more than it would hold.
        beyond: IntArray = np.sum(known[:, None] > ANGLES, axis=0)
        likelihood = beyond * np.log(more) + (len(known) - beyond) * np.log(less)
        self._log += -likelihood if taken_out else likelihood

    def aimed(self, asked: float, made: float) -> None:
        """Compare how far a poke was to lean with how far it did, rad: after two misses less is asked for."""
        if made < asked - self._settings.tolerance:
            self._hits = 0
            self._short.append(made)
            if len(self._short) >= MISSES:
                self._demand = max(LEAST, float(np.mean(self._short)) + self._settings.tolerance / 2.0)
                self._short = []
            return
        self._short = []
        self._hits = self._hits + 1 if made >= asked - self._settings.tolerance / 2.0 else 0
        if self._hits >= HITS and self._demand < self._settings.usable_tilt:
            self._hits, self._demand = 0, min(self._demand + RAISE, self._settings.usable_tilt)


@dataclass(frozen=True, slots=True, eq=False)
class Turns:
    """Which of n taxels is poked next, by how often each was poked and asked for."""

    places: FloatArray
    """(n, 3) float, metres, believed; NaN where nothing is known."""
    modules: IntArray
    """(n,) index of the module, from 0; used by `module_taxel` alone."""
    asked: IntArray
    """(n,) how often each was asked for."""
    own: IntArray
    """(n,) pokes that each answered most."""

    def taxel(self, rows: IntArray, seconds: FloatArray) -> int:
        """Return which of the taxels `rows` (m,) is next, each counted by itself: of several the one reached soonest.

        Parameters
        ----------
        seconds : (m,) until the hand has poked there
        """
        first = _first(_rounds(self.asked, self.own)[rows])
        return int(rows[first[seconds[first].argmin()]])

    def module_taxel(self, rows: IntArray, seconds: FloatArray) -> int:
        """Return which of `rows` (m,) is next where modules take turns: of several modules the one reached soonest.

        Pokes side by side say little of how a module is turned: of its taxels that were poked least, the one farthest from the
        poked ones is next. A taxel that was asked for twice in vain counts as poked.

        Parameters
        ----------
        seconds : (m,) until the hand has poked there
        """
        first = _first(_rounds(np.bincount(self.modules, self.asked), np.bincount(self.modules, self.own))[self.modules[rows]])
        module = self.modules[rows[first[seconds[first].argmin()]]]
        here = first[self.modules[rows[first]] == module]
        each = np.maximum(self.own, self.asked - 1)
        here = here[_first(each[rows[here]])]
        # Taxels of the module that were poked more often than those due, as far as their places are known.
        more = (self.modules == module) & (each > each[rows[here[0]]]) & np.isfinite(self.places).all(axis=1)
        if not more.any():
            return int(rows[here[seconds[here].argmin()]])
        off = self.places[rows[here], None] - self.places[more]
        return int(rows[here[np.sum(off * off, axis=2).min(axis=1).argmax()]])


def _first(rounds: FloatArray | IntArray) -> IntArray:
    """Return the indices of those in the earliest round."""
    return np.flatnonzero(rounds == rounds.min())


def _rounds(asked: IntArray | FloatArray, own: IntArray | FloatArray) -> FloatArray:
    """Return how many rounds each has been through: own pokes; a target missed once is due again, a later miss is a round."""
    return np.maximum(own, np.maximum(np.minimum(asked, own + 1), asked - 1)).astype(np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class AxisDiversity:
    """The sides from which n contacts of a taxel came, their places around it, and d pushes that may come next; link frame."""

    channel: int
    normal: FloatArray
    """(3,) float, unit, outward."""
    pushes: FloatArray
    """(n, 3) float, unit: which way each pushed."""
    offsets: FloatArray
    """(n, 3) float, metres, along the skin: where each was by the answers, from the taxel."""
    own: NDArray[np.bool_]
    """(n,) whether the taxel answered most."""
    trust: FloatArray
    """(n,) float, 0 to 1: how far the method believes it for this taxel."""
    beside: FloatArray
    """(3,) float, metres, along the skin: the middle of the contacts, from the taxel."""
    diversity: float
    """rad, how far the axes spread."""
    usable_tilt: float
    """rad: the most that a push is asked to lean."""
    tried: FloatArray
    """(d, 3) float, unit: pushes that may come next."""
    worth: FloatArray
    """(d,) float, metres: by how much each lowers the sum of the predicted errors; 0 where its side was skipped."""

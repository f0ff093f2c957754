"""Progress of a session: needs of each taxel, reasons to give one up, and about how many pokes are left.

A taxel is finished by what its contacts are like and by its predicted error, never by residuals: those of nearly parallel axes
agree and are wrong. The number of pokes left is good enough to plan a break by, and used for nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import BoolArray, FloatArray, IntArray
from skincal.guide.surroundings import Surroundings
from skincal.guide.taxel_statistics import TaxelStatistics
from skincal.model.scene import NoiseSettings
from skincal.taxels.result import Estimate, Method, State

MIN_CHECKED_POKES = 10
"""Fewer test pokes say nothing: with five, all are inside by chance in three sessions of four."""


@dataclass(frozen=True, slots=True)
class GuideSettings:
    """Goals and assumptions of the guide, SI units."""

    wanted: float = 0.003
    """m, predicted rms error of a finished taxel: a little over half of the 5 mm between taxels."""
    module_wanted: float = 0.0015
    """m, the same by the modules method, of the error that more pokes reduce. A module's taxels are wrong together, so at 3 mm
    one in twelve is farther off than that."""
    module_patience: int = 36
    """Pokes of its module after which an unfinished taxel is given up: more than one needs, even without a mesh."""
    bare_pokes: int = 32
    """Pokes that a module takes without a mesh, where only tilted pushes show its depth: 30 to 35 on the flat patch."""
    module_pokes: int = 4
    """Own pokes of a module: three positions fix where it lies and how it is turned, and one is spare."""
    own_pokes: int = 3
    """Own pokes of a taxel, which it answers most: those of its neighbours are to their side."""
    diversity: float = float(np.radians(15.0))
    """rad, free method: below it depth is four times less certain than the position across (1/sin)."""
    balance: float = 0.001
    """m: largest offset of the contacts' centre along the skin, and by the free method largest depth bias."""
    settled: float = 0.0005
    """m: largest shift of a taxel by its last own poke."""
    usable_tilt: float = float(np.radians(28.0))
    """rad, from the normal: a little less than the friction of a tip on foam holds."""
    tolerance: float = float(np.radians(10.0))
    """rad: a push within this angle of the target's is a hit; the hand's own error is 6 degrees (sd)."""
    sweep: float = 1.5
    """Pokes per taxel in the sweep, in which pokes between taxels say more; later ones pull neighbours together."""
    unanswered: int = 3
    """Pokes at a taxel that never answers, after which it is given up: it may be broken, or not where the layout says."""
    touch_patience: int = 6
    """Pokes meant for an untouched taxel, and answered by others, after which it is given up: twice `unanswered`."""
    turn_wanted: float = float(np.radians(3.0))
    """rad, standard deviation of a finished turn of a taxel of three axes: its 1.5 to 3 degrees are the goals of the study."""
    turn_patience: int = 12
    """Pokes on a taxel that needs nothing but its turn, until it is given up: twice the five that it usually takes."""
    patience: int = 15
    """Own pokes after which an unfinished taxel is given up: twice the mean."""
    unknown: float = 0.020
    """m, sd of an unknown position in each direction: it keeps the error of a single axis finite."""
    poke_s: float = 2.0
    """s, for a poke where the hand is: measured on the simulated operator, whose habits are assumed."""
    hand_speed: float = 0.15
    """m/s, of the hand between taxels. Assumed: slow, as one aims."""

    def wanted_by(self, method: Method) -> float:
        """Wanted predicted error by a method, m."""
        return self.module_wanted if method is Method.MODULES else self.wanted


class Need(Enum):
    """A need of a taxel; `NEED_WORDS` has its words."""

    POKES = "pokes"
    ACCURACY = "accuracy"
    SIDES = "sides"
    BALANCE = "balance"
    DEPTH = "depth"
    SETTLED = "settled"
    DECISION = "decision"
    TOUCH = "touch"
    AGREEMENT = "agreement"
    TURN = "turn"
    """Of its three axes."""


class Why(Enum):
    """Reason why a taxel is not finished; `WHY_WORDS` has its words."""

    DEAD = "dead"
    NEVER_FIRED = "never fired"
    OUT_OF_REACH = "out of reach"
    TILT = "tilt"
    AMBIGUOUS = "ambiguous"
    NOT_CONVERGED = "not converged"
    TURN_UNKNOWN = "turn unknown"
    CONTRADICTED = "contradicted"
    NOT_POKED_ENOUGH = "not poked enough"


@dataclass(frozen=True, slots=True)
class ContactFacts:
    """Statistics of one taxel's contacts (see `TaxelStatistics`), SI units."""

    own: int
    """Own pokes of the taxel (it answered strongest); by the modules method the sum over all taxels of its module."""
    diversity: float = 0.0
    offset: float = 0.0
    """Length of the offset."""
    depth_bias: float = 0.0
    last_shift: float = float("inf")
    is_covered: bool = True
    """It is touched, or surrounded by touched taxels (see `Surroundings`); only the modules method needs it."""
    contacts: int = 0
    """Pokes that it answered."""
    unanswered: int = 0
    """Pokes at it as target that it did not answer."""


def improvable_error(estimate: Estimate, skin: float) -> float:
    """Compute the part of the predicted rms error that more pokes on the skin reduce, metres; infinite without an estimate.

    It leaves out errors that all taxels share, and along the normal those of the mesh or of the skin's thickness, sd `skin`, m.
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


def find_needs(
    estimate: Estimate, facts: ContactFacts, method: Method, settings: GuideSettings, skin: float
) -> tuple[Need, ...]:
    """List the needs of a taxel by a method; none if it is finished or dead. `skin` is as for `improvable_error`."""
    if estimate.state is State.DEAD:
        return ()
    if method is Method.MODULES:
        inexact = not estimate.is_contradicted and improvable_error(estimate, skin) > settings.module_wanted
        missing = {
            Need.POKES: facts.own < settings.module_pokes,
            Need.ACCURACY: inexact,
            Need.TOUCH: not facts.is_covered,
            Need.AGREEMENT: estimate.is_contradicted,
        }
    else:
        missing = {
            Need.POKES: facts.own < settings.own_pokes,
            Need.ACCURACY: estimate.rms is None or estimate.rms > settings.wanted,
            Need.SIDES: method is Method.FREE and facts.diversity < settings.diversity,
            Need.BALANCE: facts.offset > settings.balance,
            Need.DEPTH: method is Method.FREE and abs(facts.depth_bias) > settings.balance,
            Need.SETTLED: facts.own >= settings.own_pokes and not facts.last_shift <= settings.settled,
            Need.DECISION: estimate.rival is not None,
        }
    return tuple(need for need, is_missing in missing.items() if is_missing)


def give_up_reason(
    missing: tuple[Need, ...],
    facts: ContactFacts,
    settings: GuideSettings,
    *,
    patience_exhausted: bool,
    all_sides_skipped: bool,
    tilt: float,
) -> Why | None:
    """Find the reason why the guide gives up a taxel that needs pokes; `None` if it goes on.

    Parameters
    ----------
    tilt : rad, largest usable tilt
    """
    if not missing:
        return None
    if all_sides_skipped:
        return Why.OUT_OF_REACH
    if facts.contacts == 0:
        return Why.NEVER_FIRED if facts.unanswered >= settings.unanswered or patience_exhausted else None
    if patience_exhausted and Need.AGREEMENT in missing:
        return Why.CONTRADICTED
    if patience_exhausted and missing == (Need.TURN,):
        return Why.TURN_UNKNOWN
    if patience_exhausted:
        return Why.AMBIGUOUS if Need.DECISION in missing else Why.NOT_CONVERGED
    # Axes that all lean by one angle, evenly to all sides, have just that diversity; no others have more.
    if Need.SIDES in missing and facts.own >= settings.own_pokes and tilt < settings.diversity:
        return Why.TILT
    return None


SINGLE_POKE_SD_M = {Method.FREE: 0.0070, Method.SURFACE: 0.0048}
"""sd of a taxel's position by one poke in each direction, hand and sensor together: the n-th poke moves the estimate by this
over n; by the free method depth above all. From guided sessions of the standard study, as `EXPECTED_OWN_POKE_SHARE`."""
EXPECTED_OWN_POKE_SHARE = 0.6
"""Share of the pokes that are own pokes of their target; the others are a neighbour's, which may be finished."""
POKES_TO_BALANCE_A_TAXEL = 2
"""Own pokes that it takes to balance a taxel's contacts."""
MAX_WORKING_POKE_INTERVAL_S = 30.0
"""A longer time between two pokes is a pause, not work."""
POKES_PER_INTERVAL_ESTIMATE = 20
"""Latest pokes from which the interval is measured."""


def count_pokes_left(method: Method, open_: BoolArray, know: TaxelStatistics, rms: FloatArray, settings: GuideSettings) -> int:
    """Predict the number of pokes until no taxel is open, by the free or the surface method.

    Parameters
    ----------
    open_ : (n,) taxels that need something and are not given up
    rms : (n,) float, metres, predicted; infinite while unknown
    """
    own, offset = know.own, np.maximum(know.offset_size, np.abs(know.depth_bias))
    pokes, wanted = np.minimum(own, settings.patience - 1), settings.own_pokes - own
    # The variance falls as one over the pokes.
    error = np.where(np.isfinite(rms), rms, settings.wanted)
    exact = np.ceil(np.maximum(pokes, 1) * ((error / settings.wanted) ** 2 - 1.0))
    balance = np.where((offset > settings.balance) & (pokes > 0), POKES_TO_BALANCE_A_TAXEL, 0)
    first = np.maximum.reduce([wanted, exact, balance, np.zeros(len(own))])
    unsettled = (first > 0) | ~(know.last_shift <= settings.settled)
    then = np.minimum(pokes + first, settings.patience).astype(np.int64)
    settling = np.where(unsettled, _pokes_until_settled(SINGLE_POKE_SD_M[method], settings)[then], 0.0)
    each = np.minimum(first + settling, settings.patience - pokes)
    share = float(open_.mean()) if len(open_) else 0.0
    # A poke that misses its taxel lands on a neighbour's, which is open with this share.
    return int(np.ceil(float(each[open_].sum()) / (EXPECTED_OWN_POKE_SHARE + (1.0 - EXPECTED_OWN_POKE_SHARE) * share)))


def count_module_pokes_left(
    open_: BoolArray, modules: IntArray, own: IntArray, rms: FloatArray, settings: GuideSettings, touches: int
) -> int:
    """Predict the number of pokes until no module is open, by the modules method; else as `count_pokes_left`.

    Parameters
    ----------
    modules : (n,) of each taxel
    own : (n,) pokes of its module
    rms : (n,) its `improvable_error`
    touches : that cover the taxels without a touch on or around them
    """
    size = int(modules.max(initial=-1)) + 1
    pokes, error, is_open = np.zeros(size, dtype=np.int64), np.zeros(size), np.zeros(size, dtype=bool)
    np.maximum.at(pokes, modules, own)
    np.maximum.at(error, modules, np.where(np.isfinite(rms), rms, 0.0))
    is_open[modules[open_]] = True
    exact = np.ceil(np.maximum(pokes, 1) * ((error / settings.module_wanted) ** 2 - 1.0)).astype(np.int64)
    left = np.maximum.reduce(
        [settings.module_pokes - pokes, np.minimum(exact, settings.module_patience - pokes), np.ones_like(pokes)]
    )
    count = int(left[is_open].sum())
    return max(count, touches)


def count_sheet_pokes_left(
    planned: int, pokes: int, open_: BoolArray, errors: FloatArray, settings: GuideSettings, touches: int
) -> int:
    """Predict the number of pokes until no taxel of soft sheets is open, by the modules method.

    Parameters
    ----------
    planned : pokes that the sheets need by their plan (`sheet_plan.py`)
    pokes : so far, on the sheets
    open_, errors : (n,) as for `count_module_pokes_left`
    touches : that cover the taxels without a touch on or around them
    """
    if not open_.any():
        return 0
    error = float(np.max(np.where(np.isfinite(errors[open_]), errors[open_], 0.0)))
    # Beyond the plan the worst open taxel counts: each poke at it, and at its neighbours, helps the others little.
    more = min(int(open_.sum()), int(np.ceil(pokes * ((error / settings.module_wanted) ** 3 - 1.0))))
    return max(planned - pokes, more, touches, 1)


def count_pokes_from_start(
    method: Method,
    modules: IntArray,
    settings: GuideSettings,
    surroundings: Surroundings | None = None,
    *,
    on_mesh: bool,
    on_sheets: int | None = None,
) -> int:
    """Predict the number of pokes of a whole session.

    Parameters
    ----------
    modules : (n,) of each taxel
    surroundings : neighbours of the taxels; `None` without a layout
    on_mesh : whether there is a mesh
    on_sheets : pokes that soft sheets need by their plan; `None` for boards
    """
    if method is Method.MODULES and on_sheets is not None:
        return max(on_sheets, MIN_CHECKED_POKES)
    return max(_count_from_start(method, modules, settings, surroundings, on_mesh=on_mesh), MIN_CHECKED_POKES)


def _count_from_start(
    method: Method, modules: IntArray, settings: GuideSettings, surroundings: Surroundings | None, *, on_mesh: bool
) -> int:
    count = len(modules)
    every, nothing, unknown = np.ones(count, dtype=bool), np.zeros(count, dtype=np.int64), np.full(count, np.inf)
    if method is Method.MODULES and not on_mesh:
        return settings.bare_pokes * len(np.unique(modules))
    if method is Method.MODULES:
        touches = 0 if surroundings is None else surroundings.count_touches(every)
        return count_module_pokes_left(every, modules, nothing, unknown, settings, touches)
    know = TaxelStatistics(np.arange(count), NoiseSettings(), settings.unknown, in_plane=True)
    return count_pokes_left(method, every, know, unknown, settings)


def _pokes_until_settled(sd: float, settings: GuideSettings) -> FloatArray:
    """Predict the further pokes until a taxel is settled, for each number of own pokes."""
    after = np.zeros(settings.patience + 1)
    for pokes in range(settings.patience - 1, -1, -1):
        shift = sd / (pokes + 1)
        unsettled = float(np.exp(-0.5 * (settings.settled / shift) ** 2))
        after[pokes] = unsettled * (1.0 + after[pokes + 1])
    return after


def poke_interval(times: FloatArray) -> float | None:
    """Compute the median time between the last pokes without pauses, seconds; `None` before the third poke.

    `times` is (n,), seconds, ascending: when each poke began.
    """
    steps = np.diff(times[-POKES_PER_INTERVAL_ESTIMATE - 1 :])
    steps = steps[steps <= MAX_WORKING_POKE_INTERVAL_S]
    return float(np.median(steps)) if len(steps) >= 2 else None


def working_time(begins: FloatArray, ends: FloatArray) -> float:
    """Compute the time from the first poke's begin to the last one's end without pauses, seconds."""
    if not len(begins):
        return 0.0
    waits = begins[1:] - ends[:-1]
    return float(np.sum(ends - begins) + np.sum(waits[waits <= MAX_WORKING_POKE_INTERVAL_S]))


@dataclass(frozen=True, slots=True, eq=False)
class AxisDiversity:
    """Contacts of one taxel and d pushes that may come next, link frame."""

    channel: int
    normal: FloatArray
    """(3,) float, unit, outward."""
    pushes: FloatArray
    """(n, 3) float, unit: directions of the pushes so far."""
    offsets: FloatArray
    """(n, 3) float, metres, along the skin: from the taxel to each contact."""
    own: NDArray[np.bool_]
    """(n,) whether the taxel answered most."""
    trust: FloatArray
    """(n,) float, 0 to 1: weight of each contact as an outlier of this taxel."""
    beside: FloatArray
    """(3,) float, metres, along the skin: from the taxel to the centre of the contacts."""
    diversity: float
    """rad, spread of the force axes."""
    usable_tilt: float
    """rad: largest tilt of a target."""
    tried: FloatArray
    """(d, 3) float, unit: pushes that may come next."""
    worth: FloatArray
    """(d,) float, metres: by how much each lowers the sum of the predicted errors; 0 for a side that was skipped."""

"""What the operator may do now, which corrections are available, and how estimates are drawn. Mostly pure functions."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import compress, repeat
from operator import attrgetter, is_not

import numpy as np

from app.state.memo import Memo
from app.state.running import Running
from skincal.contacts.outcome import Outcome, Rejection
from skincal.following.review import Review
from skincal.geometry import FloatArray, IntArray
from skincal.guide.guidance import Guidance, GuidePhase
from skincal.guide.progress import GuideSettings
from skincal.model.actions import Action, Correct, MarkDead, Restore, Revive
from skincal.model.scene import ContactSettings
from skincal.rig.correction import FRAME, RIG
from skincal.rig.frame_check import FrameDiagnosis
from skincal.session.corrections import offered
from skincal.session.snapshot import Snapshot
from skincal.taxels.result import Estimate, State
from skincal.words.mistake_words import frame_sentence

_POSITION_OF, _STATE_OF = attrgetter("position"), attrgetter("state")
GOOD_RMS = GuideSettings().wanted  # m. Expected errors up to this are drawn as good: the goal of the guide.
MAX_LISTED_WORST_TAXELS = 12  # Taxels in the list of the worst: as many as fit without scrolling


@dataclass(frozen=True, slots=True, eq=False)
class Offer:
    """An available correction."""

    action: Correct
    frame: FrameDiagnosis | None = None
    """Diagnosis behind a correction of the sensor's frame."""
    replaces: bool = False
    """It replaces a correction of the rig that was found from other pokes."""
    has_arm: bool = True
    """Whether joints of an arm carry the part."""


def offers_of(review: Review | None, snapshot: Snapshot, *, has_arm: bool = True) -> tuple[Offer, ...]:
    """Return the available corrections, at most one: the sensor's frame first, since all else was found under it."""
    if review is None or review.used is not snapshot.decisions.corrections:
        return ()
    action = offered(review.frame, review.rig, len(review.pokes), review.used)
    if action is None:
        return ()
    if action.of == FRAME and review.frame is not None:
        return (Offer(action, review.frame, has_arm=has_arm),)
    used = review.used.get(RIG)
    if used is not None and used.pokes == len(review.pokes):
        return ()
    return (Offer(action, replaces=used is not None, has_arm=has_arm),)


class RigReview:
    """The newest review, and the offers that were announced."""

    def __init__(self, *, has_arm: bool = True) -> None:
        self._has_arm = has_arm
        self.review: Review | None = None
        self._announced = set[tuple[str, bool, bool, str]]()
        self._offers = Memo[tuple[Offer, ...]]()

    def in_use(self, snapshot: Snapshot) -> Review | None:
        """Return the rig review if it was made under the corrections in use."""
        review = self.review
        return review if review is not None and review.used is snapshot.decisions.corrections else None

    def offers(self, snapshot: Snapshot) -> tuple[Offer, ...]:
        """Return the available corrections; the same objects until something changes."""
        return self._offers.get(
            (self.review, snapshot.decisions.corrections), lambda: offers_of(self.review, snapshot, has_arm=self._has_arm)
        )

    def news(self, snapshot: Snapshot) -> Offer | None:
        """Return an available correction of a kind that was not announced yet, once."""
        for offer in self.offers(snapshot):
            frame = offer.frame
            # The same words with another number are not news.
            words = "" if frame is None else re.sub(r"[\d.]+", "", frame_sentence(frame, has_arm=self._has_arm))
            kind = offer.action.of, offer.replaces, frame is not None and frame.sure, words
            if kind not in self._announced:
                self._announced.add(kind)
                return offer
        return None


def newest_outcome(snapshot: Snapshot) -> Outcome | None:
    """Return the outcome of the newest poke; `None` before the first."""
    return snapshot.pokes[-1].outcome if snapshot.pokes else None


def is_news(seen: Outcome | None, newest: Outcome) -> bool:
    """Whether an outcome is to be announced: it is new, and not an older poke that an undo uncovered."""
    if seen is None or newest.poke != seen.poke:
        return seen is None or newest.poke > seen.poke
    before, now = (outcome.reason if isinstance(outcome, Rejection) else None for outcome in (seen, newest))
    return before is not now


@dataclass(frozen=True, slots=True)
class Allowed:
    """What the operator may do now. An empty text means that it is not possible."""

    undo: str = ""
    """What undo would undo."""
    redo: str = ""
    exclude: tuple[Action, ...] = ()
    """Actions that exclude the selected pokes, or restore them if all are excluded."""
    exclude_text: str = ""
    taxel: Action | None = None
    """Action that disables the selected taxel, or enables it again."""
    taxel_text: str = ""
    export: bool = False
    switch_method: bool = False
    space: str = ""
    """Action of the space bar."""
    pause: str = ""
    """Action of the Pause command; unlike the space bar it never opens the verdict."""
    another: bool = False
    """Another target can be requested."""
    skip_landmarks: bool = False
    correct: Offer | None = None
    """The available correction."""
    verdict: bool = False
    ends: bool = False
    """The space bar shows the verdict."""


def allowed(
    snapshot: Snapshot,
    running: Running,
    pokes: Sequence[int],
    taxel: int | None,
    guidance: Guidance | None = None,
    offers: Sequence[Offer] = (),
) -> Allowed:
    """Determine which actions are possible for the selected `pokes` (numbers) and `taxel` (channel)."""
    pause = {Running.STREAMING: "Pause", Running.PAUSED: "Continue", Running.OFFLINE: "Connect"}.get(running, "")
    ends = running is Running.STREAMING and guidance is not None and guidance.phase is GuidePhase.ENOUGH
    exclude = _exclude_actions(snapshot, pokes)
    is_restored = bool(exclude) and isinstance(exclude[0], Restore)
    is_dead = taxel in snapshot.dead
    return Allowed(
        undo=snapshot.can_undo,
        redo=snapshot.can_redo,
        exclude=exclude,
        exclude_text="" if not exclude else "Restore selected pokes" if is_restored else "Exclude selected pokes",
        taxel=None if taxel is None else Revive(taxel) if is_dead else MarkDead(taxel),
        taxel_text="" if taxel is None else "Use selected taxel again" if is_dead else "Do not use selected taxel",
        export=any(any(map(is_not, map(_POSITION_OF, es), repeat(None))) for es in snapshot.estimates.values()),
        switch_method=len(snapshot.estimates) > 1,
        space="Verdict" if ends else pause,
        pause=pause,
        another=guidance is not None and guidance.target is not None,
        skip_landmarks=guidance is not None and (guidance.landmark is not None or guidance.closing is not None),
        correct=offers[0] if offers else None,
        verdict=guidance is not None,
        ends=ends,
    )


def _exclude_actions(snapshot: Snapshot, pokes: Sequence[int]) -> tuple[Action, ...]:
    """Return the actions that exclude pokes; if there is nothing to exclude, those that restore them."""
    # Usually nothing is selected: then the list, which may be long, is not searched.
    return (snapshot.actions_to_exclude(pokes) or snapshot.actions_to_restore(pokes)) if pokes else ()


class Mark(Enum):
    """State of a taxel as the map draws it."""

    UNSEEN = 0
    BLIND = 1
    INFERRED = 2
    ROUGH = 3
    GOOD = 4
    FINISHED_INFERRED = 5
    FINISHED = 6
    DEAD = 7


def mark_of(estimate: Estimate) -> Mark:
    """Return the mark of a taxel for which the guide still needs pokes."""
    if estimate.state is State.INFERRED:
        return Mark.INFERRED
    if estimate.position is not None:
        return Mark.GOOD if estimate.rms is not None and estimate.rms <= GOOD_RMS else Mark.ROUGH
    return {State.UNSEEN: Mark.UNSEEN, State.BLIND: Mark.BLIND}.get(estimate.state, Mark.DEAD)


def marks(estimates: Sequence[Estimate], width: int, done: Collection[int] = ()) -> IntArray:
    """Return the mark of each channel of a frame, (width,) int; channels `done` are finished for the guide."""
    result = np.full(width, Mark.UNSEEN.value, dtype=np.int64)
    for estimate in compress(estimates, map(is_not, map(_STATE_OF, estimates), repeat(State.UNSEEN))):
        is_done = estimate.channel in done and estimate.state is not State.DEAD
        finished = Mark.FINISHED_INFERRED if estimate.state is State.INFERRED else Mark.FINISHED
        result[estimate.channel] = (finished if is_done else mark_of(estimate)).value
    return result


def worst(estimates: Sequence[Estimate], shown: int = MAX_LISTED_WORST_TAXELS) -> tuple[Estimate, ...]:
    """Return the taxels that need pokes most: untouched, then undetermined, then by falling expected error."""
    order = {State.UNSEEN: 0, State.BLIND: 1, State.INFERRED: 2, State.TOUCHED: 2}
    living = [e for e in estimates if e.state is not State.DEAD]
    return tuple(sorted(living, key=lambda e: (order[e.state], -(e.rms or 0.0), e.channel))[:shown])


def curve_range(shown: float, largest: float, floor: float) -> float:
    """Return the half height of a curve's axis so that it neither clips nor changes with every sample.

    It grows at once to the next of 1, 2, 5 x 10^n above `largest`, and shrinks only when less than a third of it is used.
    `shown` is the half height now, 0 at the start, and `floor` the smallest, all in one unit.
    """
    wanted = max(floor, largest)
    if wanted <= shown and wanted > shown / 3.0:
        return shown
    decade = 10.0 ** math.floor(math.log10(wanted))
    return next((step * decade for step in (1.0, 2.0, 5.0) if wanted <= step * decade), 10.0 * decade)


def answer_levels(responses: FloatArray, settings: ContactSettings) -> FloatArray:
    """Return the response level of each channel, 0 to 1: the threshold is 0.15, ten times the threshold is 1.

    Below a third of the threshold, and for NaN, it is 0, so that noise draws nothing. Rounded to what an eye can tell apart.
    """
    share = np.nan_to_num(responses, nan=0.0, posinf=0.0, neginf=0.0) / settings.response_min
    level = np.clip(0.15 + 0.85 * (share - 1.0) / 9.0, 0.0, 1.0)
    visible = np.where(share < 1.0 / 3.0, 0.0, np.where(share < 1.0, 0.15 * share, level))
    return np.round(visible, 2).astype(np.float64)

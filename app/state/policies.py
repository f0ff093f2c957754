"""What the operator may do now, which corrections of the rig are offered, and how what is known is drawn.

Pure functions of a session's state; `RigReview` alone remembers which offers were announced.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from app.state.running import Running
from skincal.contacts.outcome import Contact, Outcome, Rejection
from skincal.geometry import FloatArray, IntArray
from skincal.guide.guidance import Guidance, GuidePhase
from skincal.guide.progress import GuideSettings
from skincal.model.actions import Correct
from skincal.model.readings import LinkHealth, Stream
from skincal.model.scene import ContactSettings, Scene
from skincal.rig.correction import FRAME, RIG
from skincal.rig.frame_check import FrameDiagnosis
from skincal.session.corrections import offered
from skincal.session.review import Review
from skincal.session.snapshot import Snapshot
from skincal.taxels.result import Estimate, State
from skincal.words.rig_words import frame_sentence


@dataclass(frozen=True, slots=True, eq=False)
class Offer:
    """A correction that could be used."""

    action: Correct
    frame: FrameDiagnosis | None = None
    """What it is found from, where it is of the sensor's frame."""
    anew: bool = False
    """Another correction of the rig is in use, found from fewer pokes or others."""


def offers_of(review: Review | None, snapshot: Snapshot) -> tuple[Offer, ...]:
    """Return what could be put right: the sensor's frame first, since all else was found under it."""
    if review is None or review.used is not snapshot.decisions.corrections:
        return ()
    frame, rig, pokes = review.frame, review.rig, len(review.pokes)
    action = offered(frame, rig, pokes, review.used)
    if action is None:
        return ()
    if action.of == FRAME and frame is not None:
        return (Offer(action, frame),)
    used = snapshot.decisions.corrections.get(RIG)
    if used is not None and used.pokes == pokes:
        return ()
    return (Offer(action, anew=used is not None),)


class RigReview:
    """Remembers the newest review and announces what it offers once."""

    def __init__(self) -> None:
        self.review: Review | None = None
        self._announced = set[tuple[str, bool, bool, str]]()
        """Kinds of offers that the operator knows of."""
        self._made: tuple[Review | None, object, tuple[Offer, ...]] = (None, None, ())
        """What the newest offers were made from, and they."""

    def shown(self, snapshot: Snapshot) -> Review | None:
        """Return the review, unless the session uses other corrections than those that it was made under."""
        review = self.review
        return review if review is not None and review.used is snapshot.decisions.corrections else None

    def offers(self, snapshot: Snapshot) -> tuple[Offer, ...]:
        """Return what could be put right; the same objects until something changes."""
        review, used, _ = self._made
        if review is not self.review or used is not snapshot.decisions.corrections:
            self._made = self.review, snapshot.decisions.corrections, offers_of(self.review, snapshot)
        return self._made[2]

    def news(self, snapshot: Snapshot) -> Offer | None:
        """Return an offer that is of another kind than those before, once."""
        offer = next(iter(self.offers(snapshot)), None)
        if offer is None:
            return None
        frame = offer.frame
        # Another number in the same words is no news.
        words = "" if frame is None else re.sub(r"[\d.]+", "", frame_sentence(frame))
        kind = offer.action.of, offer.anew, frame is not None and frame.sure, words
        if kind in self._announced:
            return None
        self._announced.add(kind)
        return offer


GOOD_RMS = GuideSettings().wanted
"""m. A predicted error up to this counts as good: what the guide works for."""
WORST_SHOWN = 12
"""Taxels in the list of the worst: what fits beside the details without scrolling."""


def newest_outcome(snapshot: Snapshot) -> Outcome | None:
    """Return what the newest poke ended as; None before the first."""
    return snapshot.pokes[-1].outcome if snapshot.pokes else None


def is_news(seen: Outcome | None, newest: Outcome) -> bool:
    """Return whether a poke's outcome is another than what was seen last; it is not where a poke was only undone."""
    if seen is None or newest.poke != seen.poke:
        return seen is None or newest.poke > seen.poke
    before, now = (outcome.reason if isinstance(outcome, Rejection) else None for outcome in (seen, newest))
    return before is not now


@dataclass(frozen=True, slots=True)
class Allowed:
    """What the operator may do now."""

    undo: str
    """What undo would take back; empty where there is nothing."""
    redo: str
    """What redo would bring again, likewise."""
    exclude: tuple[int, ...]
    """Selected pokes that count and can be excluded."""
    restore: tuple[int, ...]
    """Selected pokes that are excluded and can be restored."""
    unname: tuple[int, ...]
    """Selected pokes that no taxel answered and that count at a landmark: they can be taken from it."""
    mark_dead: bool
    revive: bool
    export: bool
    switch_method: bool
    choose_pose: bool
    space: str
    """What the space bar does; empty where it does nothing."""
    pause: str
    """What the entry beside the space bar's does, which never shows the verdict."""
    another: bool = False
    """A target may be left for another."""
    skip_landmarks: bool = False
    """A landmark is asked for."""
    correct: Offer | None = None
    """What could be put right of the rig; None where nothing is offered."""
    verdict: bool = False
    """There is a guide, so the session has come to something."""
    ends: bool = False
    """The space bar shows the verdict."""


def allowed(
    snapshot: Snapshot,
    scene: Scene,
    links: Sequence[LinkHealth],
    running: Running,
    pokes: Sequence[int],
    taxel: int | None,
    guidance: Guidance | None = None,
    offers: Sequence[Offer] = (),
) -> Allowed:
    """Return what may be done in this state with the selection: numbers of `pokes`, and the channel of a `taxel`."""
    pause = {Running.STREAMING: "Pause", Running.PAUSED: "Go on", Running.OFFLINE: "Connect"}.get(running, "")
    ends = running is Running.STREAMING and guidance is not None and guidance.phase is GuidePhase.ENOUGH
    wanted = set(pokes)
    # Mostly nothing is selected: then the list, which may be long, is not looked through.
    chosen = [record for record in snapshot.pokes if record.outcome.poke in wanted] if wanted else []
    streamed = any(Stream.JOINTS in link.carries for link in links)
    return Allowed(
        undo=snapshot.can_undo,
        redo=snapshot.can_redo,
        # A rejected poke counts for nothing already.
        exclude=tuple(p.outcome.poke for p in chosen if not p.excluded and isinstance(p.outcome, Contact)),
        restore=tuple(p.outcome.poke for p in chosen if p.excluded),
        unname=tuple(
            p.outcome.poke for p in chosen if p.outcome.poke in snapshot.at_landmarks and isinstance(p.outcome, Rejection)
        ),
        mark_dead=taxel is not None and taxel not in snapshot.dead,
        revive=taxel is not None and taxel in snapshot.dead,
        export=any(e.state is State.ESTIMATED for es in snapshot.estimates.values() for e in es),
        switch_method=len(snapshot.estimates) > 1,
        choose_pose=scene.arm is not None and bool(scene.arm.poses) and not streamed,
        space="Verdict" if ends else pause,
        pause=pause,
        another=guidance is not None and guidance.target is not None,
        skip_landmarks=guidance is not None and (guidance.landmark is not None or guidance.closing is not None),
        correct=offers[0] if offers else None,
        verdict=guidance is not None,
        ends=ends,
    )


class Mark(Enum):
    """State of a taxel as the map draws it, by shape and fill."""

    UNSEEN = 0
    BLIND = 1
    ROUGH = 2
    GOOD = 3
    DONE = 4
    DEAD = 5


def mark_of(estimate: Estimate) -> Mark:
    """Return how a taxel is drawn."""
    state = estimate.state
    if state is State.UNSEEN:
        return Mark.UNSEEN
    if state is State.ESTIMATED:
        return Mark.GOOD if estimate.rms is not None and estimate.rms <= GOOD_RMS else Mark.ROUGH
    return Mark.BLIND if state is State.BLIND else Mark.DEAD


def marks(estimates: Sequence[Estimate], width: int, done: Collection[int] = ()) -> IntArray:
    """Return the mark of each channel of a frame, (width,) int; a channel without an estimate was never poked.

    The guide needs nothing more of channels that are `done`.
    """
    result = np.full(width, Mark.UNSEEN.value, dtype=np.int64)
    for estimate in estimates:
        if estimate.state is not State.UNSEEN:
            is_done = estimate.channel in done and estimate.state is not State.DEAD
            result[estimate.channel] = (Mark.DONE if is_done else mark_of(estimate)).value
    return result


def worst(estimates: Sequence[Estimate], shown: int = WORST_SHOWN) -> tuple[Estimate, ...]:
    """Return the taxels that need pokes most: the unseen, then blind ones, then by falling predicted error."""
    order = {State.UNSEEN: 0, State.BLIND: 1, State.ESTIMATED: 2}
    living = [e for e in estimates if e.state is not State.DEAD]
    return tuple(sorted(living, key=lambda e: (order[e.state], -(e.rms or 0.0), e.channel))[:shown])


def curve_range(shown: float, largest: float, floor: float) -> float:
    """Return the half height of a curve's axis so that it neither clips nor breathes with every sample.

    It grows at once to the next step of 1, 2, 5 x 10^n above `largest`, what is on the screen, and shrinks only when less than
    a third of it is used. `shown` is the half height now, 0 at the start, and `floor` the smallest, all in one unit.
    """
    wanted = max(floor, largest)
    if wanted <= shown and wanted > shown / 3.0:
        return shown
    decade = 10.0 ** math.floor(math.log10(wanted))
    return next((step * decade for step in (1.0, 2.0, 5.0) if wanted <= step * decade), 10.0 * decade)


def answer_levels(responses: FloatArray, settings: ContactSettings) -> FloatArray:
    """Return how strongly each channel answers, 0 to 1: the threshold is 0.15, ten times the threshold is 1.

    Below a third of the threshold it is 0, so that noise draws nothing; NaN gives 0. Rounded to what an eye can see.
    """
    share = np.nan_to_num(responses, nan=0.0, posinf=0.0, neginf=0.0) / settings.response_min
    level = np.clip(0.15 + 0.85 * (share - 1.0) / 9.0, 0.0, 1.0)
    visible = np.where(share < 1.0 / 3.0, 0.0, np.where(share < 1.0, 0.15 * share, level))
    return np.round(visible, 2).astype(np.float64)

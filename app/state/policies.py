"""What the operator may do now, and how what is known is drawn: pure functions of a session's state, without a memory."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from app.state.rig_review import Offer
from app.state.running import Running
from skincal.contacts.outcome import Contact, Outcome, Rejection
from skincal.geometry.arrays import FloatArray, IntArray
from skincal.guide.guidance import Guidance, GuidePhase
from skincal.guide.progress import GuideSettings
from skincal.model.readings import LinkHealth, Stream
from skincal.model.scene import ContactSettings, Scene
from skincal.session.snapshot import PokeRecord, Snapshot
from skincal.taxels.result import Estimate, State

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
    return _kind(seen) != _kind(newest)


def _kind(outcome: Outcome) -> object:
    return outcome.reason if isinstance(outcome, Rejection) else Contact


@dataclass(frozen=True, slots=True)
class Allowed:
    """What the operator may do now."""

    undo: str
    """What undo would take back; empty where there is nothing."""
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
    """Return what may be done with the selection in this state.

    Parameters
    ----------
    pokes : numbers of the selected pokes
    taxel : the selected channel
    guidance : None where nobody guides
    offers : what could put the rig right
    """
    pause = {Running.STREAMING: "Pause", Running.PAUSED: "Go on", Running.OFFLINE: "Connect"}.get(running, "")
    ends = running is Running.STREAMING and guidance is not None and guidance.phase is GuidePhase.ENOUGH
    chosen = _selected(snapshot.pokes, pokes)
    streamed = any(Stream.JOINTS in link.carries for link in links)
    return Allowed(
        undo=snapshot.can_undo,
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
        skip_landmarks=guidance is not None and guidance.landmark is not None,
        correct=offers[0] if offers else None,
        verdict=guidance is not None,
        ends=ends,
    )


def _selected(records: Sequence[PokeRecord], pokes: Sequence[int]) -> list[PokeRecord]:
    wanted = set(pokes)
    return [p for p in records if p.outcome.poke in wanted] if wanted else []


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

    Parameters
    ----------
    done : channels that the guide needs nothing more of
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

    It grows at once to the next step of 1, 2, 5 x 10^n above `largest` and shrinks only when less than a third of it
    is used.

    Parameters
    ----------
    shown : half height that is shown now, 0 at the start
    largest : largest size on the screen, same unit
    floor : smallest half height, same unit
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

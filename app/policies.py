"""What is said and what may be done, as pure functions of the snapshot, the live view and the scene.

Nothing here knows Qt or keeps state: what has to be remembered between two ticks (a verdict that stays long enough to
be read, a phase that must last before it is announced) is a frozen value that goes in and comes out.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from app.coaching import SILENT, CoachMemory, Force, follow, force_words, hint_words, pressing_words
from app.display_units import count, newtons, number
from app.frame import Frame
from app.guide_words import (
    BETWEEN,
    asked_words,
    done_words,
    end_words,
    enough_words,
    landmark_poked_words,
    newly_done,
    target_words,
    why_words,
)
from app.rig_offers import Offer
from app.running import Running
from app.words import LinkLook, LinkWords, counted_words, link_words, peak_channel, verdict_detail, verdict_words
from skincal.contacts.outcome import Contact, Outcome, PressPhase, Rejection
from skincal.geometry.arrays import FloatArray, IntArray
from skincal.guide.coaching import PRESSING
from skincal.guide.guidance import Guidance, GuidePhase
from skincal.guide.progress import GuideSettings
from skincal.model.readings import LinkHealth, Stream
from skincal.model.scene import ContactSettings, Scene
from skincal.session.snapshot import PokeRecord, Snapshot
from skincal.taxels.result import Estimate, State

VERDICT_S = 2.5
"""s. A verdict stays at least this long unless the next poke begins: a dozen words are read in it."""
SETTLE_S = 0.15
"""s. A calm phase must last this long before it is said, so that the line does not flicker with noise."""
GOOD_RMS = GuideSettings().wanted
"""m. A predicted error up to this counts as good: what the guide works for."""
WORST_SHOWN = 12
"""Taxels in the list of the worst: what fits beside the details without scrolling."""


class Tone(Enum):
    """The mood of the line; each has its own colour and its own sign."""

    CALM = "calm"
    WAIT = "wait"
    GO = "go"
    HOLD = "hold"
    GOOD = "good"
    BAD = "bad"


@dataclass(frozen=True, slots=True)
class Now:
    """What is happening, verb first, and one line of detail."""

    tone: Tone
    headline: str
    detail: str = ""


@dataclass(frozen=True, slots=True)
class NowMemory:
    """What the line remembers between two ticks."""

    outcome: Outcome | None = None
    """The newest poke that was seen."""
    verdict_until_s: float = -math.inf
    phase: PressPhase = PressPhase.NO_DATA
    """The phase that is said."""
    coming: PressPhase = PressPhase.NO_DATA
    coming_since_s: float = -math.inf
    asked: int | None = None
    """Channel that the frame before asked to poke."""
    meant: int | None = None
    """Channel that was asked for when the newest poke was made."""
    guidance: Guidance | None = None
    """The frame's before."""
    done: tuple[int, ...] = ()
    """Channels that became done with the newest poke, ascending."""
    coach: CoachMemory = SILENT

    @staticmethod
    def of(snapshot: Snapshot) -> NowMemory:
        """Return a memory that does not announce the pokes that are there already."""
        return NowMemory(outcome=newest_outcome(snapshot))


def now_line(memory: NowMemory, at: Frame) -> tuple[Now, NowMemory]:
    """Return what is said now, and what has to be remembered.

    Trouble goes before everything. A poke in progress is said at once; a
    verdict stays `VERDICT_S`; a calm phase is said once it lasted `SETTLE_S`.
    """
    memory = _settle(_see_guidance(_see_outcome(memory, at), at), at)
    memory = replace(memory, coach=follow(memory.coach, at))
    trouble = _trouble(at)
    if trouble is not None:
        return trouble, memory
    if memory.phase in PRESSING:
        return _pressing(memory, at), memory
    if at.now_s < memory.verdict_until_s and memory.outcome is not None:
        return _verdict(memory.outcome, memory, at), memory
    return _calm(memory.phase, at), memory


def newest_outcome(snapshot: Snapshot) -> Outcome | None:
    """Return what the newest poke ended as; None before the first."""
    return snapshot.pokes[-1].outcome if snapshot.pokes else None


def is_news(told: Outcome | None, newest: Outcome) -> bool:
    """Return whether a poke's verdict is another than what was told last; none where a poke was only taken back."""
    if told is None or newest.poke != told.poke:
        return told is None or newest.poke > told.poke
    return _kind(told) != _kind(newest)


def _see_outcome(memory: NowMemory, at: Frame) -> NowMemory:
    newest = newest_outcome(at.snapshot)
    if newest is not None and at.snapshot.pokes[-1].excluded:
        # It was taken back: nobody must read that it counts.
        return replace(memory, outcome=newest, verdict_until_s=-math.inf)
    if newest is None or newest is memory.outcome:
        return memory
    grown = newly_done(memory.guidance, at.guidance)
    if is_news(memory.outcome, newest):
        until_s = at.now_s + VERDICT_S
        return replace(memory, outcome=newest, verdict_until_s=until_s, meant=memory.asked, done=tuple(sorted(grown)))
    if memory.outcome is None or newest.poke < memory.outcome.poke:
        return replace(memory, outcome=newest, done=())
    # The same poke again, with the tare after it: that may be what a taxel lacked.
    return replace(memory, outcome=newest, done=tuple(sorted(grown.union(memory.done))))


def _see_guidance(memory: NowMemory, at: Frame) -> NowMemory:
    asked = None if at.target is None else at.target.channel
    if asked == memory.asked and at.guidance is memory.guidance:
        return memory
    return replace(memory, asked=asked, guidance=at.guidance)


def _kind(outcome: Outcome) -> object:
    return outcome.reason if isinstance(outcome, Rejection) else Contact


def _settle(memory: NowMemory, at: Frame) -> NowMemory:
    phase = at.live.progress.phase
    if phase is not memory.coming:
        memory = replace(memory, coming=phase, coming_since_s=at.now_s)
    # A poke's begin and end are said at once: the detector's own two thresholds keep them from flickering.
    if phase in PRESSING or memory.phase in PRESSING or at.now_s - memory.coming_since_s >= SETTLE_S:
        memory = replace(memory, phase=phase)
    return memory


def _trouble(at: Frame) -> Now | None:
    if at.running is Running.OPENING:
        return Now(Tone.WAIT, "opening", at.scene.name)
    if at.running is Running.PAUSED:
        return Now(Tone.CALM, "paused", "Nothing is recorded; the space bar goes on.")
    if at.running is Running.OFFLINE:
        return Now(Tone.CALM, "no device connected", "Look, change and export; the space bar connects the devices.")
    lost = next((link for link in at.links if link.look is LinkLook.LOST), None)
    if lost is not None:
        return Now(Tone.BAD, f"lost {lost.name}", lost.detail or "It is taken up again by itself.")
    return None


def _pressing(memory: NowMemory, at: Frame) -> Now:
    how = pressing_words(at.coaching, at.target, at.names)
    if memory.phase is PressPhase.HELD:
        return Now(Tone.GOOD, "enough, release", how or "The still window is full.")
    hint = memory.coach.hint
    asked = hint_words(hint, at.target, at.names) if hint is not None and at.target is not None else ""
    force, detail = force_words(memory.coach, at)
    if force:
        tone = Tone.HOLD if memory.coach.force is Force.LOW else Tone.BAD
        return Now(tone, force, BETWEEN.join(filter(None, (detail, asked or how))))
    return Now(Tone.HOLD, asked or "hold still", f"{detail}{BETWEEN}{how}" if how else f"{detail}, keep the tip where it is")


def _verdict(outcome: Outcome, memory: NowMemory, at: Frame) -> Now:
    name = at.snapshot.at_landmarks.get(outcome.poke)
    if name is not None:
        return Now(Tone.GOOD, landmark_poked_words(outcome.poke, name), _next(at))
    detail = verdict_detail(outcome, at.snapshot, at.method, at.names)
    if isinstance(outcome, Rejection):
        return Now(Tone.BAD, verdict_words(outcome, at.names), detail)
    words = verdict_words(outcome, at.names)
    if memory.meant is not None and memory.meant != peak_channel(outcome):
        words, detail = counted_words(outcome, at.names), asked_words(outcome, memory.meant, at.names)
    # Whoever is quick pokes again while this is still said.
    return Now(Tone.GOOD, words, BETWEEN.join(filter(None, (done_words(memory.done, at.names), _next(at), detail))))


def _calm(phase: PressPhase, at: Frame) -> Now:
    if at.unsolved:
        left = f"{count(at.unsolved, 'taxel')} to go: what changed concerns all of them. Pokes count meanwhile."
        return Now(Tone.WAIT, "solving anew", left)
    if phase is PressPhase.NO_DATA:
        return _no_data(at)
    if phase is PressPhase.TARING:
        following = _next(at)
        taring = (
            f"Taring.  {following}" if following else "Taring: the sensor's offset is taken while nothing touches the part."
        )
        return Now(Tone.WAIT, "keep hands off", taring)
    return _guided(at) or _ready(at)


def _next(at: Frame) -> str:
    """Return what to do next, or that it is enough; empty where nobody guides."""
    if at.guidance is not None and at.guidance.phase is GuidePhase.ENOUGH:
        return enough_words(at.guidance, GOOD_RMS, at.snapshot.dead)
    if at.guidance is None or at.target is None:
        return ""
    return f"Next: {target_words(at.guidance, at.target, at.names)}"


def _guided(at: Frame) -> Now | None:
    guidance, dead = at.guidance, at.snapshot.dead
    if guidance is None:
        return None
    if guidance.phase is GuidePhase.ENOUGH:
        first = "C uses the correction that is offered. " if at.offers else ""
        return Now(Tone.GOOD, enough_words(guidance, GOOD_RMS, dead), first + end_words(guidance, dead))
    if at.target is None:
        return None
    return Now(Tone.GO, target_words(guidance, at.target, at.names), why_words(guidance, at.target, dead))


def _ready(at: Frame) -> Now:
    limits = at.scene.contacts
    low, high = number(limits.force_min, 0), newtons(limits.force_max, 0)
    return Now(Tone.GO, "ready: poke", f"Press {low} to {high} onto a taxel and hold {number(limits.still_s, 1)} s.")


def _no_data(at: Frame) -> Now:
    missing = [link.name for link in at.links if link.look in (LinkLook.WAITING, LinkLook.SILENT)]
    if missing:
        detail = next((link.detail for link in at.links if link.name == missing[0]), "")
        return Now(Tone.WAIT, f"waiting for {' and '.join(missing)}", detail)
    if at.links and all(link.look is LinkLook.ENDED for link in at.links):
        return Now(Tone.CALM, "recording ended", "Everything that was recorded has been read.")
    return Now(Tone.WAIT, "waiting for data", "Both streams must run before a poke can be taken.")


def link_lines(
    links: Sequence[LinkHealth], now_ns: int, clock_offset: float = 0.0, running: Running = Running.STREAMING
) -> tuple[LinkWords, ...]:
    """Return what is said of each link."""
    connected = running is Running.STREAMING
    return tuple(link_words(link, now_ns, clock_offset, connected=connected) for link in links)


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
    correct: str = ""
    """What could be put right of the rig; empty where nothing is offered."""
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
        correct=offers[0].text if offers else "",
        verdict=guidance is not None,
        ends=ends,
    )


def _selected(records: Sequence[PokeRecord], pokes: Sequence[int]) -> list[PokeRecord]:
    wanted = set(pokes)
    return [p for p in records if p.outcome.poke in wanted] if wanted else []


class Mark(Enum):
    """State of a taxel as the map draws it: told by shape and fill."""

    UNSEEN = 0
    BLIND = 1
    ROUGH = 2
    GOOD = 3
    DONE = 4
    DEAD = 5


MARK_WORDS: Mapping[Mark, str] = {
    Mark.UNSEEN: "not poked yet",
    Mark.BLIND: "axes do not determine it",
    Mark.ROUGH: f"estimated, error above {GOOD_RMS * 1e3:.0f} mm",
    Mark.GOOD: f"estimated, error up to {GOOD_RMS * 1e3:.0f} mm",
    Mark.DONE: "done, the guide needs nothing more of it",
    Mark.DEAD: "not used",
}


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

    Below a third of the threshold it is 0, so that noise draws nothing; NaN gives 0. Rounded to what an eye can tell apart.
    """
    share = np.nan_to_num(responses, nan=0.0, posinf=0.0, neginf=0.0) / settings.response_min
    level = np.clip(0.15 + 0.85 * (share - 1.0) / 9.0, 0.0, 1.0)
    visible = np.where(share < 1.0 / 3.0, 0.0, np.where(share < 1.0, 0.15 * share, level))
    return np.round(visible, 2).astype(np.float64)

"""The line that says what is happening, as a pure function of what a tick hands to the views.

What has to be remembered between two ticks (a verdict that stays long enough to be read, a phase that must last before it is
announced) is a frozen value that goes in and comes out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum

from app.state.policies import is_news, newest_outcome
from app.state.press_coach import SILENT, CoachMemory, Force, follow_press
from app.state.running import Running
from app.state.view_state import FAULTS, LinkLook, ViewState
from app.text.guidance_text import (
    BETWEEN,
    asked_words,
    done_words,
    end_words,
    enough_words,
    force_words,
    hint_words,
    newly_done,
    pressing_words,
    round_pokes,
    target_words,
    why_words,
)
from app.text.outcomes import (
    METHOD_NAMES,
    MISSED_ADVICE,
    counted_words,
    landed_words,
    link_detail,
    peak_channel,
    verdict_detail,
    verdict_words,
)
from skincal.contacts.outcome import Outcome, PressPhase, Rejection
from skincal.guide.guidance import PRESSING, Guidance, GuidePhase
from skincal.guide.progress import GuideSettings
from skincal.model.readings import LinkAnswer, Stream
from skincal.session.snapshot import Snapshot
from skincal.session.undo import LastOperation, OperationKind
from skincal.words.poke_words import missed_words
from skincal.words.units import count, newtons, number

VERDICT_S = 2.5
"""s. A verdict stays at least this long unless the next poke begins: a dozen words are read in it."""
DEED_S = 6.0
"""s. What the operator took back, or brought again, is said so long: it was asked for, and must not be missed."""
SETTLE_S = 0.15
"""s. A calm phase must last this long before it is said, so that the line does not flicker with noise."""


POSES_NAMED = 3
CHANGE_HINT = "  \N{MIDDLE DOT}  A changes addresses"
_SHORT_VERDICTS = {
    LinkAnswer.NO_READING: "no readings",
    LinkAnswer.OTHER_STREAM: "another stream",
    LinkAnswer.OTHER_WIDTH: "wrong number of values",
}
"""For large type; the line below says all of it."""


class Tone(Enum):
    """The mood of the line; each has its own colour and its own sign."""

    CALM = "calm"
    WAIT = "wait"
    GO = "go"
    HOLD = "hold"
    GOOD = "good"
    BAD = "bad"


@dataclass(frozen=True, slots=True)
class Said:
    """What came of something: smaller than what to do, and beside it."""

    tone: Tone
    words: str


@dataclass(frozen=True, slots=True)
class Now:
    """What to do now, verb first, in large type; one line of detail; and what came of the poke or the action before."""

    tone: Tone
    headline: str
    detail: str = ""
    result: Said | None = None


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
    deed: LastOperation | None = None
    """What the operator did last."""
    deed_until_s: float = -math.inf

    @staticmethod
    def of(snapshot: Snapshot) -> NowMemory:
        """Return a memory that does not announce what is there already: pokes, and what the operator did."""
        return NowMemory(outcome=newest_outcome(snapshot), deed=snapshot.history.last)


def now_line(memory: NowMemory, at: ViewState) -> tuple[Now, NowMemory]:
    """Return what is said now, and what has to be remembered.

    Trouble goes before everything. A poke in progress is said at once; a verdict stays `VERDICT_S`; a calm phase is said after
    `SETTLE_S`.
    """
    asked = None if at.target is None else at.target.channel
    memory = replace(_see_deed(_see_outcome(memory, at), at), asked=asked, guidance=at.guidance)
    memory = replace(_settle(memory, at), coach=follow_press(memory.coach, at))
    deed = _deed(memory, at)
    trouble = _trouble(at)
    if trouble is not None:
        return replace(trouble, result=deed), memory
    if memory.phase in PRESSING:
        return replace(_pressing(memory, at), result=deed), memory
    if deed is None and at.now_s < memory.verdict_until_s and memory.outcome is not None:
        return _verdict(memory.outcome, memory, at), memory
    return replace(_calm(memory.phase, at), result=deed or _costs(at)), memory


def _see_deed(memory: NowMemory, at: ViewState) -> NowMemory:
    """Notice what the operator did; a poke that ends after it is news again."""
    deed = at.snapshot.history.last
    if deed is None or deed == memory.deed:
        return memory
    return replace(memory, deed=deed, deed_until_s=at.now_s + DEED_S, verdict_until_s=-math.inf)


def _deed(memory: NowMemory, at: ViewState) -> Said | None:
    if memory.deed is None or at.now_s >= memory.deed_until_s:
        return None
    return Said(Tone.CALM, deed_words(memory.deed))


def deed_words(deed: LastOperation) -> str:
    """Return what the operator did, and what takes it back: `"poke 438 taken back; Ctrl+Y brings it again"`."""
    if deed.kind is OperationKind.UNDONE:
        return f"{deed.name} taken back; Ctrl+Y brings it again"
    if deed.kind is OperationKind.REDONE:
        return f"{deed.name} brought again; Backspace takes it back"
    return f"{deed.name}: done; Backspace takes it back"


def _costs(at: ViewState) -> Said | None:
    """Return what each method would cost, until a poke on the skin counts; None where nobody knows."""
    known = [(method, pokes) for method, pokes in at.costs.items() if pokes]
    if len(known) < 2 or at.snapshot.contacts:
        return None
    each = ", ".join(f"{METHOD_NAMES[method]} about {round_pokes(pokes)}" for method, pokes in known)
    return Said(Tone.CALM, f"pokes it takes: {each}; V chooses the method")


def _see_outcome(memory: NowMemory, at: ViewState) -> NowMemory:
    newest = newest_outcome(at.snapshot)
    if newest is not None and at.snapshot.pokes[-1].excluded:
        # It was taken back: nobody must read that it counts.
        return replace(memory, outcome=newest, verdict_until_s=-math.inf)
    if newest is None or newest is memory.outcome:
        return memory
    grown = newly_done(memory.guidance, at.guidance)
    if is_news(memory.outcome, newest):
        until_s = at.now_s + VERDICT_S
        return replace(
            memory,
            outcome=newest,
            verdict_until_s=until_s,
            deed_until_s=-math.inf,
            meant=memory.asked,
            done=tuple(sorted(grown)),
        )
    if memory.outcome is None or newest.poke < memory.outcome.poke:
        return replace(memory, outcome=newest, done=())
    # The same poke again, with the tare after it: that may be what a taxel lacked.
    return replace(memory, outcome=newest, done=tuple(sorted(grown.union(memory.done))))


def _settle(memory: NowMemory, at: ViewState) -> NowMemory:
    phase = at.live.progress.phase
    if phase is not memory.coming:
        memory = replace(memory, coming=phase, coming_since_s=at.now_s)
    # A poke's begin and end are said at once: the detector's own two thresholds keep them from flickering.
    if phase in PRESSING or memory.phase in PRESSING or at.now_s - memory.coming_since_s >= SETTLE_S:
        memory = replace(memory, phase=phase)
    return memory


def _trouble(at: ViewState) -> Now | None:
    if at.running is Running.OPENING:
        return Now(Tone.WAIT, "opening", at.scene.name)
    if at.running is Running.PAUSED:
        return Now(Tone.CALM, "paused", "Nothing is recorded; the space bar goes on.")
    if at.running is Running.OFFLINE:
        return Now(Tone.CALM, "no device connected", "Look, change and export; the space bar connects the devices.")
    fault = next((link for link in at.live.links if at.look(link) in FAULTS), None)
    if fault is not None:
        how = f"lost {fault.link}" if at.look(fault) is LinkLook.LOST else f"{fault.link} is frozen"
        return Now(Tone.BAD, how, link_detail(fault, at) or "It is taken up again by itself.")
    return None


def _pressing(memory: NowMemory, at: ViewState) -> Now:
    how = pressing_words(at.coaching, at.target, at.names)
    if memory.phase is PressPhase.HELD:
        return Now(Tone.GOOD, "held: release", how or "The still window is full.")
    hint = memory.coach.hint
    asked = hint_words(hint, at.target, at.names) if hint is not None and at.target is not None else ""
    force, detail = force_words(memory.coach, at)
    if force:
        tone = Tone.HOLD if memory.coach.force is Force.LOW else Tone.BAD
        return Now(tone, force, BETWEEN.join(filter(None, (detail, asked or how))))
    return Now(Tone.HOLD, asked or "hold still", f"{detail}{BETWEEN}{how}" if how else f"{detail}, keep the tip where it is")


def _verdict(outcome: Outcome, memory: NowMemory, at: ViewState) -> Now:
    """Return what to do next, with what the newest poke ended as beside it."""
    said, detail = _ended(outcome, memory, at)
    # A quick operator pokes again while this is still said.
    following = _calm(memory.phase, at) if at.guidance is None or at.unsolved else _guided(at)
    return Now(following.tone, following.headline, detail or following.detail, said)


def _ended(outcome: Outcome, memory: NowMemory, at: ViewState) -> tuple[Said, str]:
    """Return how a poke ended, and what it changed or what to do better."""
    number = f"poke {outcome.poke}"
    name = at.snapshot.at_landmarks.get(outcome.poke)
    if name is not None:
        return Said(Tone.GOOD, f"{number} counts at the landmark {name}"), ""
    missed = at.snapshot.decisions.missed_landmarks.get(outcome.poke)
    if missed is not None:
        lands = landed_words(outcome, at.names)
        tone = Tone.BAD if isinstance(outcome, Rejection) else Tone.GOOD
        return Said(tone, f"{number} {lands}{missed_words(missed)}"), MISSED_ADVICE
    detail = verdict_detail(outcome, at.snapshot, at.method, at.names)
    words = verdict_words(outcome, at.names)
    if isinstance(outcome, Rejection):
        return Said(Tone.BAD, f"{number} {words}"), detail
    if memory.meant is not None and memory.meant != peak_channel(outcome):
        words, detail = counted_words(outcome, at.names), asked_words(outcome, memory.meant, at.names)
    return Said(Tone.GOOD, f"{number} {words}"), BETWEEN.join(filter(None, (done_words(memory.done, at.names), detail)))


def _calm(phase: PressPhase, at: ViewState) -> Now:
    if at.unsolved:
        left = f"{count(at.unsolved, 'taxel')} to go: what changed concerns all of them. Pokes count meanwhile."
        return Now(Tone.WAIT, "solving anew", left)
    if phase is PressPhase.NO_DATA:
        return _no_data(at)
    if phase is PressPhase.TARING and not at.lacks_pose:
        following = _next(at)
        what = f".  {following}" if following else ": the sensor's offset is taken while nothing touches the part."
        return Now(Tone.WAIT, "keep hands off", f"Taring{what}")
    return _guided(at)


def _next(at: ViewState) -> str:
    """Return what to do next, or that it is enough; empty where nobody guides."""
    if at.guidance is not None and at.guidance.phase is GuidePhase.ENOUGH:
        return enough_words(at.guidance, at.snapshot.dead)
    if at.guidance is None or at.target is None:
        return ""
    return f"Next: {target_words(at.guidance, at.target, at.names)}"


def _guided(at: ViewState) -> Now:
    guidance, dead = at.guidance, at.snapshot.dead
    if at.lacks_pose:
        return _ask_pose(at)
    if guidance is not None and guidance.phase is GuidePhase.ENOUGH:
        first = "C uses the correction that is offered. " if at.offers else ""
        return Now(Tone.GOOD, enough_words(guidance, dead), first + end_words(guidance, dead))
    if guidance is not None and at.target is not None:
        return Now(Tone.GO, target_words(guidance, at.target, at.names), why_words(guidance, at.target, dead))
    limits = at.scene.contacts
    low, high = number(limits.force_min, 0), newtons(limits.force_max, 0)
    return Now(Tone.GO, "ready: poke", f"Press {low} to {high} onto a taxel and hold {number(limits.still_s, 1)} s.")


def _ask_pose(at: ViewState) -> Now:
    """Return what is asked before the first poke, which would not count without it."""
    if any(Stream.JOINTS in link.carries for link in at.live.links):
        return Now(Tone.WAIT, "waiting for joints", "They say the arm's pose, without which no poke counts.")
    names = list(at.scene.arm.poses) if at.scene.arm is not None else []
    if not names:
        return Now(Tone.BAD, "arm pose unknown", f"The scene names none: connect the joints.{CHANGE_HINT}")
    some = ", ".join(names[:POSES_NAMED]) + (", \N{HORIZONTAL ELLIPSIS}" if len(names) > POSES_NAMED else "")
    return Now(Tone.GO, "which arm pose?", f"No poke counts without it. Key 7, then choose: {some}")


def _no_data(at: ViewState) -> Now:
    links = at.live.links
    wrong = next((link for link in links if at.look(link) is LinkLook.WRONG), None)
    if wrong is not None:
        return Now(Tone.BAD, f"{wrong.link}: {_SHORT_VERDICTS[wrong.verdict.answer]}", f"{link_detail(wrong, at)}{CHANGE_HINT}")
    missing = [link for link in links if at.look(link) in (LinkLook.WAITING, LinkLook.SILENT)]
    if missing:
        return Now(Tone.WAIT, f"waiting for {' and '.join(link.link for link in missing)}", link_detail(missing[0], at))
    if links and all(at.look(link) is LinkLook.ENDED for link in links):
        return Now(Tone.CALM, "recording ended", "Everything that was recorded has been read.")
    return Now(Tone.WAIT, "waiting for data", "Both streams must run before a poke can be taken.")


def modules_enough_words() -> str:
    """Return what is said once the modules method needs no more, while another is shown."""
    settings = GuideSettings()
    pokes, wanted = settings.module_pokes, 1e3 * settings.module_wanted
    words = f"By the modules method it is enough: {pokes} pokes on every module, predicted errors of at most {wanted:g} mm."
    return f"{words} The box above the map, or V, shows that method; then F leads to the file."

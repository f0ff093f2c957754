"""Status line: what to do now, made from the state of a tick and a frozen memory of the ticks before.

`_trouble` has the sentence for a lost link. Its second part comes from `link_detail` (`link_text.py`); sentences on links that
reports and commands share are in `skincal/words/link_words.py`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from app.state.policies import is_news, newest_outcome
from app.state.press_coach import NO_HINT, CoachMemory, ForceLevel, follow_press
from app.state.running import Running
from app.state.status_line import Now, Said, Tone
from app.state.view_state import LINK_FAULTS, LinkStatus, ViewState
from app.text.guidance_text import (
    DOT_SEPARATOR,
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
from app.text.link_text import link_detail
from skincal.contacts.outcome import PRESSING_PHASES, Outcome, PressPhase, Rejection
from skincal.guide.guidance import Guidance, GuidePhase
from skincal.guide.progress import GuideSettings
from skincal.model.readings import LinkAnswer, Stream
from skincal.session.snapshot import Snapshot
from skincal.session.undo import LastOperation, OperationKind
from skincal.taxels.poke_figures import peak_channel
from skincal.words.link_words import link_name
from skincal.words.outcome_words import accepted_words, landed_words, outcome_detail, outcome_headline
from skincal.words.poke_words import MISSED_ADVICE, missed_words
from skincal.words.taxel_words import rig_name
from skincal.words.units import count, newtons, number

MIN_POKE_RESULT_SHOWN_S = 2.5
"""The result of a poke stays at least this long unless the next poke begins: enough to read a dozen words."""
LAST_ACTION_SHOWN_S = 6.0  # The operator's last action is shown this long
IDLE_PHASE_DEBOUNCE_S = 0.15
"""An idle phase must last this long before it is shown, so that noise does not make the line flicker."""

MAX_NAMED_ARM_POSES = 3
CHANGE_HINT = "  \N{MIDDLE DOT}  A: change addresses"
_SHORT_VERDICTS = {
    LinkAnswer.NO_READING: "no readings",
    LinkAnswer.OTHER_STREAM: "another stream",
    LinkAnswer.OTHER_WIDTH: "wrong number of values",
}
"""For large type; the line below has the details."""
_SHORT_NAMES = {"wrench": "sensor"}  # Short names of devices, for the large line of the window


@dataclass(frozen=True, slots=True)
class NowMemory:
    """Memory of the status line between two ticks."""

    outcome: Outcome | None = None
    """Newest poke."""
    verdict_until_s: float = -math.inf
    phase: PressPhase = PressPhase.NO_DATA
    """Phase that is shown."""
    coming: PressPhase = PressPhase.NO_DATA
    coming_since_s: float = -math.inf
    asked: int | None = None
    """Channel requested in the tick before."""
    meant: int | None = None
    """Channel requested when the newest poke was made."""
    guidance: Guidance | None = None
    """Guidance of the tick before."""
    done: tuple[int, ...] = ()
    """Channels finished by the newest poke, ascending."""
    coach: CoachMemory = NO_HINT
    deed: LastOperation | None = None
    """Last action of the operator."""
    deed_until_s: float = -math.inf

    @staticmethod
    def from_snapshot(snapshot: Snapshot) -> NowMemory:
        """Make a memory for which all past pokes and actions are already announced."""
        return NowMemory(outcome=newest_outcome(snapshot), deed=snapshot.history.last)


def now_line(memory: NowMemory, at: ViewState) -> tuple[Now, NowMemory]:
    """Make the status line and the memory for the next tick.

    A problem comes first, then a poke in progress, then a result for `MIN_POKE_RESULT_SHOWN_S`, then an idle phase after
    `IDLE_PHASE_DEBOUNCE_S`.
    """
    asked = None if at.target is None else at.target.channel
    memory = replace(_see_deed(_see_outcome(memory, at), at), asked=asked, guidance=at.guidance)
    memory = replace(_settle(memory, at), coach=follow_press(memory.coach, at))
    deed = _deed(memory, at)
    trouble = _trouble(at)
    if trouble is not None:
        return replace(trouble, result=deed), memory
    if memory.phase in PRESSING_PHASES:
        return replace(_pressing(memory, at), result=deed), memory
    if deed is None and at.now_s < memory.verdict_until_s and memory.outcome is not None:
        return _verdict(memory.outcome, memory, at), memory
    return replace(_calm(memory.phase, at), result=deed or _costs(at)), memory


def _see_deed(memory: NowMemory, at: ViewState) -> NowMemory:
    """Remember the operator's newest action, to show it for some seconds."""
    deed = at.snapshot.history.last
    if deed is None or deed == memory.deed:
        return memory
    return replace(memory, deed=deed, deed_until_s=at.now_s + LAST_ACTION_SHOWN_S, verdict_until_s=-math.inf)


def _deed(memory: NowMemory, at: ViewState) -> Said | None:
    if memory.deed is None or at.now_s >= memory.deed_until_s:
        return None
    return Said(Tone.CALM, deed_words(memory.deed))


def deed_words(deed: LastOperation) -> str:
    """Name the operator's last action, with the key that reverses it: `"poke 438 undone (Ctrl+Y: redo)"`."""
    if deed.kind is OperationKind.UNDONE:
        return f"{deed.name} undone (Ctrl+Y: redo)"
    if deed.kind is OperationKind.REDONE:
        return f"{deed.name} redone (Backspace: undo)"
    return f"{deed.name} (Backspace: undo)"


def _costs(at: ViewState) -> Said | None:
    """Predict the pokes that each method needs, before the first poke on the skin; `None` if unknown."""
    known = [(method, pokes) for method, pokes in at.costs.items() if pokes]
    if len(known) < 2 or at.snapshot.contacts:
        return None
    each = ", ".join(f"{round_pokes(pokes)} ({method.value})" for method, pokes in known)
    return Said(Tone.CALM, f"Pokes needed: about {each}. V switches the method")


def _see_outcome(memory: NowMemory, at: ViewState) -> NowMemory:
    newest = newest_outcome(at.snapshot)
    if newest is not None and at.snapshot.pokes[-1].excluded:
        # It was undone: the line must not say that it counts.
        return replace(memory, outcome=newest, verdict_until_s=-math.inf)
    if newest is None or newest is memory.outcome:
        return memory
    grown = newly_done(memory.guidance, at.guidance)
    if is_news(memory.outcome, newest):
        memory = replace(memory, verdict_until_s=at.now_s + MIN_POKE_RESULT_SHOWN_S, deed_until_s=-math.inf)
        return replace(memory, outcome=newest, meant=memory.asked, done=tuple(sorted(grown)))
    if memory.outcome is None or newest.poke < memory.outcome.poke:
        return replace(memory, outcome=newest, done=())
    # The same poke again, with the tare after it, which may finish a taxel.
    return replace(memory, outcome=newest, done=tuple(sorted(grown.union(memory.done))))


def _settle(memory: NowMemory, at: ViewState) -> NowMemory:
    phase = at.live.progress.phase
    if phase is not memory.coming:
        memory = replace(memory, coming=phase, coming_since_s=at.now_s)
    # Begin and end of a poke are shown at once: the detector's two thresholds prevent flicker.
    if phase in PRESSING_PHASES or memory.phase in PRESSING_PHASES or at.now_s - memory.coming_since_s >= IDLE_PHASE_DEBOUNCE_S:
        memory = replace(memory, phase=phase)
    return memory


def begin_sentence(words: str) -> str:
    """Make the first letter a capital, unless the sentence begins with a device's address, which is case-sensitive."""
    return words if "://" in words.partition(" ")[0] else f"{words[:1].upper()}{words[1:]}"


def _trouble(at: ViewState) -> Now | None:
    if at.running is Running.OPENING:
        return Now(Tone.WAIT, "Opening", at.scene.name)
    if at.running is Running.PAUSED:
        return Now(Tone.CALM, "Paused", "Not recording. Space: continue")
    if at.running is Running.OFFLINE:
        return Now(Tone.CALM, "No device connected", "You can look, change and export. Space: connect the devices")
    if at.robot_halted:
        return Now(Tone.WAIT, "Robot stopped", "S: let it go on. Keep its emergency stop within reach")
    fault = next((link for link in at.live.links if at.status_of(link) in LINK_FAULTS), None)
    if fault is not None:
        name = link_name(fault)
        how = "lost" if at.status_of(fault) is LinkStatus.LOST else "stuck"
        detail = link_detail(fault, at) or "Reconnecting automatically"
        return Now(Tone.BAD, f"{name[:1].upper()}{name[1:]} {how}", begin_sentence(detail))
    return None


def _pressing(memory: NowMemory, at: ViewState) -> Now:
    how = pressing_words(at.coaching, at.target, at.names)
    if memory.phase is PressPhase.HELD:
        return Now(Tone.GOOD, "Release", how or "Held long enough")
    hint = memory.coach.hint
    asked = hint_words(hint, at.target, at.names) if hint is not None and at.target is not None else ""
    force, detail = force_words(memory.coach, at)
    if force:
        tone = Tone.HOLD if memory.coach.force is ForceLevel.LOW else Tone.BAD
        return Now(tone, force, DOT_SEPARATOR.join(filter(None, (detail, asked or how))))
    return Now(
        Tone.HOLD, asked or "Hold still", f"{detail}{DOT_SEPARATOR}{how}" if how else f"{detail}, keep the tip where it is"
    )


def _verdict(outcome: Outcome, memory: NowMemory, at: ViewState) -> Now:
    """Show the result of the newest poke above the next step."""
    said, detail = _ended(outcome, memory, at)
    # A quick operator pokes again while this is still shown.
    following = _calm(memory.phase, at) if at.guidance is None or at.unsolved else _guided(at)
    return Now(following.tone, following.headline, detail or following.detail, said)


def _ended(outcome: Outcome, memory: NowMemory, at: ViewState) -> tuple[Said, str]:
    """Describe the outcome of a poke, and its effect or advice."""
    number = f"Poke {outcome.poke}"
    name = at.snapshot.at_landmarks.get(outcome.poke)
    if name is not None:
        return Said(Tone.GOOD, f"{number} accepted at landmark {name}"), ""
    missed = at.snapshot.decisions.missed_landmarks.get(outcome.poke)
    if missed is not None:
        lands = landed_words(outcome, at.names)
        tone = Tone.BAD if isinstance(outcome, Rejection) else Tone.GOOD
        return Said(tone, f"{number} {lands}{missed_words(missed)}"), MISSED_ADVICE
    peak = peak_channel(outcome)
    detail = outcome_detail(outcome, at.snapshot.estimate_of(peak, at.method), at.snapshot.part_size, at.names)
    words = outcome_headline(outcome, at.names)
    if isinstance(outcome, Rejection):
        return Said(Tone.BAD, f"{number} {words}"), detail
    if memory.meant is not None and memory.meant != peak:
        words = accepted_words(outcome, at.names, memory.meant)
    return Said(Tone.GOOD, f"{number} {words}"), DOT_SEPARATOR.join(filter(None, (done_words(memory.done, at.names), detail)))


def _calm(phase: PressPhase, at: ViewState) -> Now:
    if at.unsolved:
        return Now(Tone.WAIT, f"Recomputing {count(at.unsolved, 'taxel')}", "You can keep poking")
    if phase is PressPhase.NO_DATA:
        return _no_data(at)
    if phase is PressPhase.TARING and not at.lacks_pose:
        following = _next(at)
        what = f". {following}" if following else " while nothing touches the part"
        if not at.scene.has_sensor:
            return Now(Tone.WAIT, "Hold the tip above the part", f"Measuring the skin at rest{what}")
        if at.scene.tool is not None:
            return Now(Tone.WAIT, "Hold the tool above the part", f"Zeroing sensor and skin{what}")
        return Now(Tone.WAIT, "Hands off", f"Zeroing the sensor{what}")
    return _guided(at)


def _next(at: ViewState) -> str:
    """Name the next step, or the end; empty without a guide."""
    if at.guidance is not None and at.guidance.phase is GuidePhase.ENOUGH:
        return enough_words(at.guidance, at.snapshot.dead)
    if at.guidance is None or at.target is None:
        return ""
    words = target_words(at.guidance, at.target, at.names)
    return f"Next: {words[:1].lower()}{words[1:]}"


def _guided(at: ViewState) -> Now:
    guidance, dead = at.guidance, at.snapshot.dead
    if at.lacks_pose:
        return _ask_pose(at)
    if guidance is not None and guidance.phase is GuidePhase.ENOUGH:
        rig = rig_name(at.scene.arm is not None)
        first = f"C: apply the correction of {rig}. " if at.offers else ""
        return Now(Tone.GOOD, enough_words(guidance, dead), first + end_words(guidance, dead))
    if guidance is not None and at.target is not None:
        return Now(
            Tone.GO,
            target_words(guidance, at.target, at.names),
            why_words(guidance, at.target, dead, at.snapshot.part_size, has_tool=at.scene.tool is not None),
        )
    limits = at.scene.contacts
    low, high = number(limits.force_min, 0), newtons(limits.force_max, 0)
    how = f" with {low} to {high}" if at.scene.has_sensor else ""
    return Now(Tone.GO, "Ready", f"Press a taxel{how} and hold still for {number(limits.still_s, 1)} s")


def _ask_pose(at: ViewState) -> Now:
    """Ask for the arm pose, without which no poke counts."""
    if at.scene.tool is not None:
        thing = "sensor" if at.scene.has_sensor else "tip"
        return Now(Tone.WAIT, "Waiting for the tool", f"Its poses say where the {thing} is. Pokes count only then")
    if any(Stream.JOINTS in link.carries for link in at.live.links):
        return Now(Tone.WAIT, "Waiting for the joints", "They give the arm pose. Pokes count only then")
    names = list(at.scene.arm.poses) if at.scene.arm is not None else []
    if not names:
        return Now(Tone.BAD, "Arm pose unknown", f"The scene has no named poses: connect the joints{CHANGE_HINT}")
    some = ", ".join(names[:MAX_NAMED_ARM_POSES]) + (", \N{HORIZONTAL ELLIPSIS}" if len(names) > MAX_NAMED_ARM_POSES else "")
    return Now(Tone.GO, "Choose the arm pose", f"Pokes count only then. Key 7: {some}")


def _no_data(at: ViewState) -> Now:
    links = at.live.links
    wrong = next((link for link in links if at.status_of(link) is LinkStatus.WRONG), None)
    if wrong is not None:
        name, verdict = link_name(wrong), _SHORT_VERDICTS[wrong.verdict.answer]
        return Now(Tone.BAD, f"{name[:1].upper()}{name[1:]}: {verdict}", f"{link_detail(wrong, at)}{CHANGE_HINT}")
    missing = [link for link in links if at.status_of(link) in (LinkStatus.WAITING, LinkStatus.SILENT)]
    if missing:
        names = ", ".join(_SHORT_NAMES.get(link.link, link.link) for link in missing)
        return Now(Tone.WAIT, f"Waiting for {names}", link_detail(missing[0], at))
    if links and all(at.status_of(link) is LinkStatus.ENDED for link in links):
        return Now(Tone.CALM, "Recording ended", "The recording is at its end")
    return Now(Tone.WAIT, "Waiting for data", f"{_needed_streams(at)} must stream before a poke counts")


def _needed_streams(at: ViewState) -> str:
    """Name the streams without which no poke counts."""
    if at.scene.tool is None:
        return "Sensor and skin"
    return "Sensor, skin and tool" if at.scene.has_sensor else "Skin and tool"


def modules_enough_words() -> str:
    """Announce that the modules method is finished while another method is shown."""
    settings = GuideSettings()
    pokes, wanted = settings.module_pokes, 1e3 * settings.module_wanted
    words = f"The modules method is finished: {pokes} pokes on every module or sheet, and {wanted:g} mm or less of each error"
    return f"{words} that more pokes would reduce. V switches to it, then F shows the result."

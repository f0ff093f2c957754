"""What a robot that pokes is asked in an open session, and what its answers mean: the guide's targets by number, and verdicts.

Every time that something is asked for it has another number. A poke is of what was asked for when its still window began;
once it is judged for good, its number is accepted or rejected, and the next is asked for. A target that changes takes the
place of the one before. Nothing here knows a port: what is made of a tick goes out as lines, and what came in is told.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from skincal.contacts.outcome import Contact
from skincal.guide.guidance import Guidance
from skincal.model.actions import AskLandmark, BeginClosing
from skincal.model.errors import InputError
from skincal.model.scene import Scene
from skincal.robot.target_lines import Answer, AnswerKind, AskedLine, Judged, NoTarget, PokeTarget, write_answer, write_line
from skincal.robot.target_server import RobotCame, TargetServer
from skincal.session.guiding import SessionGuide, asked_poke
from skincal.session.part import Part, lay_part
from skincal.session.snapshot import PokeRecord, Snapshot
from skincal.session.solving import methods_of
from skincal.taxels.result import Method
from skincal.words.poke_words import missed_words, rejection_words

if TYPE_CHECKING:
    from skincal.session.pipeline import Pipeline

FELT_S = 3.0
"""s. A poke is judged within half a second after the tool has left; where none was felt so long after a robot says that it was
there, none will be."""
SETTLED_S = 2.0
"""s. The next target waits so long at most for a verdict: links that stop leave a poke open."""
HOLDS = 2.0
"""Times the still window: the force has to settle, too."""
REMEMBERED = 8
"""Targets that a late poke may be of."""
STEP_NS = 20_000_000
"""ns between two looks at what is asked for, without a window."""
NOT_FELT = f"no poke was felt within {FELT_S:g} s after it was said to be reached"


def first_method(methods: Sequence[Method], part: Part) -> Method:
    """Return the method that is followed first: modules where their layout lies on a mesh, since it takes far fewer pokes."""
    if Method.MODULES in methods and part.surface is not None and part.laid is not None:
        return Method.MODULES
    return Method.SURFACE if Method.SURFACE in methods else methods[0]


def act_on(guidance: Guidance | None, pipeline: Pipeline, now_ns: int) -> None:
    """Record what the guide asks for, where that changed: which landmark, and that some places are poked once more."""
    name = "" if guidance is None or guidance.landmark is None else guidance.landmark.landmark.name
    if name != pipeline.asked_landmark:
        pipeline.act(AskLandmark(name), now_ns)
    asked = asked_poke(guidance)
    if asked != pipeline.session.asked:
        pipeline.act(asked, now_ns)
    # What is shown may be older than the session, in which it began meanwhile.
    closing = None if guidance is None else guidance.closing
    if closing is not None and len(pipeline.session.decisions.closings) < closing.number:
        pipeline.act(BeginClosing(), now_ns)


@dataclass(slots=True)
class _Asked:
    """Something that was asked for."""

    target: PokeTarget
    at_s: float
    reached_s: float | None = None
    open: bool = True
    """It is what is asked for now."""
    judged: bool = False
    """Nothing more is said of it."""

    def end(self) -> None:
        """Ask for it no more, and say no more of it."""
        self.open, self.judged = False, True


@dataclass(frozen=True, slots=True)
class Meaning:
    """What an answer means for who asked."""

    skips: bool = False
    """The guide is to ask for another poke."""
    trouble: str = ""
    """A sentence for the operator."""
    lie: str = ""
    """What cannot be: who says so is hung up on."""


class PokeAsking:
    """Turns what the guide wants into lines for a robot, and its answers into what they mean."""

    def __init__(self, scene: Scene) -> None:
        self._frame = scene.link
        self._asked: deque[_Asked] = deque(maxlen=REMEMBERED)
        self._said: NoTarget | None = None
        """What was said last, where that was no target."""
        self._held = False
        """The robot has stopped: nothing is asked for until it comes again, or wants another target."""
        self._judged = -1
        """Number of the newest poke of the session that is judged, or that was there before."""
        self._number = 0

    def follow(
        self, guidance: Guidance | None, snapshot: Snapshot, pose: str, now_s: float, *, measuring: bool
    ) -> list[AskedLine]:
        """Give the lines to send now.

        Parameters
        ----------
        guidance : `None` while guidance is off
        pose : name of the current arm pose
        now_s : host's monotonic clock, seconds
        measuring : a poke would be measured; else nobody is asked to press
        """
        lines: list[AskedLine] = []
        waiting = self._judge(snapshot, now_s, lines)
        wanted = self._wanted(guidance, snapshot, pose, measuring=measuring)
        if waiting and wanted is not NoTarget.WAIT:
            return lines
        if isinstance(wanted, NoTarget):
            if wanted is not self._said:
                self._said = wanted
                self._withdraw()
                lines.append(wanted)
        elif not self._is_asked(wanted):
            self._withdraw()
            self._number += 1
            self._asked.append(_Asked(replace(wanted, number=self._number), now_s))
            self._said = None
            lines.append(self._asked[-1].target)
        return lines

    def came(self) -> None:
        """Take up again where a robot had stopped: it came back."""
        self._held = False

    def hear(self, answer: Answer, now_s: float) -> Meaning:
        """Take a robot's answer."""
        if not 0 < answer.number <= self._number:
            return Meaning(lie=f"it answers {write_answer(answer)[:40]!r}, and was asked {self._number} at most.")
        asked, skips = self._asked[-1], answer.kind is AnswerKind.SKIP
        of_newest = answer.number == asked.target.number
        if of_newest and skips and self._held:
            self._held = False
            return Meaning(skips=True)
        if not of_newest or not asked.open:
            # Another has taken its place meanwhile, or it is judged: what was said has crossed this.
            return Meaning()
        if answer.kind is AnswerKind.REACHED:
            asked.reached_s = now_s
            return Meaning()
        asked.end()
        if skips:
            return Meaning(skips=True)
        self._held = True
        why = answer.text or "it does not say why"
        return Meaning(
            trouble=f"The robot has stopped at target {answer.number}: {why}. It is asked again once it connects anew, "
            "or for another once it skips this one."
        )

    def _wanted(self, guidance: Guidance | None, snapshot: Snapshot, pose: str, *, measuring: bool) -> PokeTarget | NoTarget:
        """Return what somebody who looks at the guide would do."""
        if not measuring or self._held:
            return NoTarget.WAIT
        if guidance is None:
            return NoTarget.ANY
        target = guidance.target
        if target is None:
            return NoTarget.ENOUGH if guidance.enough else NoTarget.WAIT
        limits = snapshot.decisions.thresholds
        force, hold = (limits.force_min + limits.force_max) / 2.0, HOLDS * limits.still_s
        known = bool(target.landmark)
        return PokeTarget(0, target.channel, target.place, target.push, known, self._frame, pose, force, hold)

    def _is_asked(self, wanted: PokeTarget) -> bool:
        """Return whether just that is asked for already; the arm's pose aside, whose name follows its joints' tremor."""
        if self._said is not None or not self._asked or not self._asked[-1].open:
            return False
        now, wanted = (replace(each, number=0, pose="") for each in (self._asked[-1].target, wanted))
        return write_line(now) == write_line(wanted)

    def _withdraw(self) -> None:
        if self._asked:
            self._asked[-1].open = False

    def _judge(self, snapshot: Snapshot, now_s: float, lines: list[AskedLine]) -> bool:
        """Add verdicts on pokes that are final; return whether one is to come before anything else is asked for."""
        if self._judged < 0:
            self._judged = max((record.outcome.poke for record in snapshot.pokes), default=0)
        for record in _newer(snapshot.pokes, self._judged):
            outcome = record.outcome
            asked = next((each for each in reversed(self._asked) if each.at_s <= outcome.start_s), None)
            if not outcome.final and now_s - outcome.end_s < SETTLED_S:
                return asked is not None and asked.open
            self._judged = outcome.poke
            if asked is not None and not asked.judged:
                asked.end()
                lines.append(Judged(asked.target.number, _why_not(record, snapshot)))
        newest = self._asked[-1] if self._asked else None
        if newest is not None and newest.open and newest.reached_s is not None and now_s - newest.reached_s > FELT_S:
            newest.end()
            lines.append(Judged(newest.target.number, NOT_FELT))
        return False


def _newer(pokes: Sequence[PokeRecord], than: int) -> list[PokeRecord]:
    """Return the pokes after a number, in their order: they stand at the end."""
    count = 0
    while count < len(pokes) and pokes[-1 - count].outcome.poke > than:
        count += 1
    return list(pokes[len(pokes) - count :])


def _why_not(record: PokeRecord, snapshot: Snapshot) -> str:
    """Return why a poke does not count; empty where it does, on the skin or at a landmark."""
    outcome = record.outcome
    if outcome.poke in snapshot.decisions.missed_landmarks:
        return missed_words(snapshot.decisions.missed_landmarks[outcome.poke])
    if isinstance(outcome, Contact) or outcome.poke in snapshot.at_landmarks:
        return ""
    return rejection_words(outcome)


def take_answers(server: TargetServer, asking: PokeAsking, now_s: float) -> tuple[int, list[str]]:
    """Take what robots said since the last call; return how often another target is wanted, and sentences for the operator."""
    skips, sentences = 0, list[str]()
    for item in server.take():
        if isinstance(item, str):
            sentences.append(item)
        elif isinstance(item, RobotCame):
            asking.came()
        else:
            meaning = asking.hear(item, now_s)
            skips += meaning.skips
            sentences += filter(None, [meaning.trouble])
            if meaning.lie:
                server.refuse(meaning.lie)
    return skips, sentences


class RobotGuide:
    """Guides a robot through a recording that has no window.

    Parameters
    ----------
    method : whose needs the guide follows; the one that the window shows first where None
    """

    def __init__(self, pipeline: Pipeline, server: TargetServer, method: Method | None) -> None:
        part = lay_part(pipeline.scene, pipeline.session.surface, ())
        methods = methods_of(part.scene, part.surface)
        if method is not None and method not in methods:
            known = " or ".join(each.value for each in methods)
            raise InputError(f"the scene has no {method.value} method; expected --method {known}.")
        self._pipeline, self._server, self._method = pipeline, server, method or first_method(methods, part)
        self._guide, self._asking = SessionGuide(part), PokeAsking(part.scene)
        self._next_ns = 0
        self.enough = False
        """Nothing more is asked for."""

    def step(self, now_ns: int) -> list[str]:
        """Do what is due at `now_ns` of the host's monotonic clock; return sentences for the operator."""
        if now_ns < self._next_ns:
            return []
        self._next_ns = now_ns + STEP_NS
        pipeline, now_s = self._pipeline, now_ns * 1e-9
        skips, sentences = take_answers(self._server, self._asking, now_s)
        for _ in range(skips):
            if (skip := self._guide.skip()) is not None:
                pipeline.act(skip, now_ns)
        snapshot = pipeline.snapshot()
        evidence = pipeline.session.evidence
        guidance = self._guide.next_target(snapshot, pipeline.poses.current, self._method, evidence, now_s)
        act_on(guidance, pipeline, now_ns)
        name, measuring = pipeline.poses.current[0], pipeline.measures(now_ns)
        lines = self._asking.follow(guidance, snapshot, name, now_s, measuring=measuring)
        self._server.send(lines)
        self.enough |= NoTarget.ENOUGH in lines
        return sentences

"""Dialogue with a robot that pokes: the guide's targets as numbered lines, verdicts on its pokes, and its answers.

Each request has a new number. A poke belongs to the request that was open when its still window began. Once it is final, the
number is accepted or rejected and the next target follows. A target that changes replaces the one before.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

from skincal.contacts.outcome import Contact
from skincal.guide.guidance import Guidance
from skincal.model.scene import Scene
from skincal.rig.part_pose import PartPose
from skincal.robot.target_lines import (
    Answer,
    AnswerKind,
    AskedLine,
    GuidedByHand,
    Held,
    Judged,
    NoTarget,
    PartPlace,
    PokeTarget,
    write_answer,
    write_line,
)
from skincal.session.snapshot import PokeRecord, Snapshot
from skincal.words.poke_words import missed_words, rejection_words

POKE_DETECTION_TIMEOUT_S = 3.0
"""s. If no poke is detected within this time after the robot reports "reached", the target has failed. A poke is judged within
half a second after the tool has left."""
POKE_VERDICT_TIMEOUT_S = 2.0
"""s. The next target waits this long at most for a verdict: links that stop leave a poke open."""
HOLD_TIME_IN_STILL_WINDOWS = 2.0
"""A robot is asked to hold for this many still windows, since the force has to settle, too."""
MAX_UNANSWERED_TARGETS = 8
"""Targets that a late poke may belong to."""
NOT_DETECTED = f"no poke was felt within {POKE_DETECTION_TIMEOUT_S:g} s after it was said to be reached"


@dataclass(slots=True)
class _Request:
    target: PokeTarget
    at_s: float
    reached_s: float | None = None
    is_open: bool = True
    """It is the current request."""
    is_judged: bool = False
    """No verdict on it follows."""
    is_held: bool = False
    """The robot knows that it may let go."""
    is_by_hand: bool = False
    """The robot says that a person guides the tip to this known point."""
    is_driven: bool = False
    """The robot said where its tip is in the part's frame, or that it reached this known point: it knows the part's pose."""
    judged_s: float | None = None
    """Time of the verdict on its poke; `None` before, without a poke, and if a robot connected since."""
    landmark: str = ""
    """Name of the landmark that its poke was at; empty before, and at none."""

    def end(self) -> None:
        self.is_open, self.is_judged = False, True


@dataclass(frozen=True, slots=True)
class Meaning:
    """Result of a robot's answer."""

    wants_other_target: bool = False
    impossible: str = ""
    """Why the robot can never do the current target; empty if it can, or does not say."""
    warning: str = ""
    """A sentence for the operator."""
    protocol_error: str = ""
    """Why the answer is impossible: the robot is disconnected with it."""


class RobotDialogue:
    """Turns guidance into lines for a robot, and its answers into their meaning."""

    def __init__(self, scene: Scene) -> None:
        self._frame = scene.link
        self._requests: deque[_Request] = deque(maxlen=MAX_UNANSWERED_TARGETS)
        self._last_line: NoTarget | None = None
        """The last line if it was no target."""
        self._is_stopped = False
        """After a fault: no target is sent until the robot connects again or wants another target."""
        self.is_halted = False
        """The operator has stopped the robot."""
        self._reasons: set[str] = set()
        """Reasons for skips that the operator knows."""
        self._driven: list[str] = []
        """Landmarks of `take_driven`."""
        self._asks_who_moves = False
        """A robot is connected, and its silence at a landmark was not reported yet."""
        self._part: PartPose | None = None
        """Pose of the part that the robot knows."""
        self._judged_poke = -1
        """Number of the newest poke that is judged, or that was there before."""
        self._number = 0

    @property
    def has_open_request(self) -> bool:
        """Whether a target is open that the robot may be on its way to."""
        return bool(self._requests) and self._requests[-1].is_open

    def lines_to_send(
        self,
        guidance: Guidance | None,
        snapshot: Snapshot,
        pose: str,
        now_s: float,
        *,
        measuring: bool,
        held: bool = False,
    ) -> list[AskedLine]:
        """Give the lines to send now.

        Parameters
        ----------
        guidance : `None` while guidance is off
        pose : name of the current arm pose
        now_s : host's monotonic clock, seconds
        measuring : a poke would be measured; else no robot is asked to press
        held : the poke in progress is held long enough
        """
        lines: list[AskedLine] = []
        is_waiting = self._judge_pokes(snapshot, now_s, lines)
        newest = self._requests[-1] if self._requests else None
        if held and newest is not None and newest.is_open and not newest.is_held:
            newest.is_held = True
            lines.append(Held(newest.target.number))
        part = snapshot.part_pose
        # An arm that drives to a landmark by a pose from the landmarks before it measures nothing: a hand guides it to each.
        target = None if guidance is None else guidance.target
        is_guided = self._part is None and target is not None and bool(target.landmark)
        if part is not None and part.is_known and part is not self._part and not is_guided:
            self._part = part
            lines.append(PartPlace(self._frame, part.base_from_link))
        if self.is_halted:
            return lines
        wanted = self._wanted_line(guidance, snapshot, pose, measuring=measuring)
        if is_waiting and wanted is not NoTarget.WAIT:
            return lines
        if isinstance(wanted, NoTarget):
            if wanted is not self._last_line:
                self._last_line = wanted
                self._withdraw()
                lines.append(wanted)
        elif not self._is_asked(wanted):
            self._withdraw()
            self._number += 1
            self._requests.append(_Request(replace(wanted, number=self._number), now_s))
            self._last_line = None
            lines.append(self._requests[-1].target)
        return lines

    def halt(self) -> list[AskedLine]:
        """Stop the robot at once; give the lines to send at once. A robot that does not know `stop` waits."""
        self.is_halted, self._last_line = True, NoTarget.STOP
        self._withdraw()
        return [NoTarget.WAIT, NoTarget.STOP]

    def go_on(self) -> None:
        """Send targets again to a robot that was stopped."""
        self.is_halted = False

    def robot_connected(self) -> None:
        """Send targets again after a robot's fault, and the pose of the part."""
        self._is_stopped, self._part = False, None
        self._asks_who_moves = True
        for request in self._requests:
            request.judged_s = None

    def robot_left(self) -> None:
        """Expect no word of a robot."""
        self._asks_who_moves = False

    def handle_answer(self, answer: Answer, now_s: float) -> Meaning:
        """Process a robot's answer and return its meaning."""
        if not 0 < answer.number <= self._number:
            return Meaning(protocol_error=f"it answers {write_answer(answer)[:40]!r}, and was asked {self._number} at most.")
        if answer.kind is AnswerKind.REACHED:
            for each in self._requests:
                if each.target.number == answer.number:
                    self._note_drive(each)
        request, skips = self._requests[-1], answer.kind is AnswerKind.SKIP
        is_newest = answer.number == request.target.number
        if is_newest and skips and self._is_stopped:
            self._is_stopped = False
            return self._skipped(answer)
        if not is_newest or not request.is_open:
            # The answer crossed the next target or the verdict.
            return Meaning()
        if answer.kind is AnswerKind.REACHED:
            request.reached_s = now_s
            return Meaning()
        request.end()
        if skips:
            return self._skipped(answer)
        self._is_stopped = True
        why = answer.text or "it does not say why"
        return Meaning(
            warning=f"The robot has stopped at target {answer.number}: {why}. It is asked again once it connects again, "
            "or for another once it skips this one."
        )

    def note_hand(self, line: GuidedByHand) -> None:
        """Remember that a person guides the tip to a known point; the robot may have said where its tip is before."""
        for request in self._requests:
            request.is_by_hand |= request.target.number == line.number

    def note_tip(self) -> None:
        """Remember that a robot with a known point to go to says where its tip is in the part's frame."""
        if self.has_open_request:
            self._note_drive(self._requests[-1])

    def _note_drive(self, request: _Request) -> None:
        """Remember that the robot drives to a known point; this may show before or after the verdict on the poke."""
        if request.target.known and not request.is_by_hand and not request.is_driven:
            request.is_driven = True
            self._driven += [request.landmark] if request.landmark else []

    def take_driven(self) -> list[str]:
        """Return the landmarks that the robot drove to since the last call: the newest poke at each is meant."""
        driven, self._driven = self._driven, []
        return driven

    def take_silent(self, now_s: float) -> str:
        """Return a landmark that was touched, about which a connected robot said nothing; once for each connection.

        Whether the robot drove there is unknown. Its `reached` has the time of an undetected poke to arrive.
        """
        if not self._asks_who_moves:
            return ""
        for request in self._requests:
            is_silent = request.landmark and not (request.is_by_hand or request.is_driven)
            if is_silent and request.judged_s is not None and now_s - request.judged_s > POKE_DETECTION_TIMEOUT_S:
                self._asks_who_moves = False
                return request.landmark
        return ""

    def _skipped(self, answer: Answer) -> Meaning:
        is_new = answer.text not in {"", *self._reasons}
        self._reasons.add(answer.text)
        warning = f"The robot cannot do target {answer.number}: {answer.text}. It gets another one." if is_new else ""
        return Meaning(wants_other_target=True, impossible=answer.text, warning=warning)

    def _wanted_line(
        self, guidance: Guidance | None, snapshot: Snapshot, pose: str, *, measuring: bool
    ) -> PokeTarget | NoTarget:
        if not measuring or self._is_stopped:
            return NoTarget.WAIT
        if guidance is None:
            return NoTarget.ANY
        target = guidance.target
        if target is None:
            return NoTarget.ENOUGH if guidance.enough else NoTarget.WAIT
        limits = snapshot.decisions.thresholds
        force, hold = (limits.force_min + limits.force_max) / 2.0, HOLD_TIME_IN_STILL_WINDOWS * limits.still_s
        known = bool(target.landmark)
        return PokeTarget(0, target.channel, target.place, target.push, known, self._frame, pose, force, hold)

    def _is_asked(self, wanted: PokeTarget) -> bool:
        """Whether the current request is the same, apart from the pose's name, which follows the joints' tremor."""
        if self._last_line is not None or not self._requests or not self._requests[-1].is_open:
            return False
        now, wanted = (replace(each, number=0, pose="") for each in (self._requests[-1].target, wanted))
        return write_line(now) == write_line(wanted)

    def _withdraw(self) -> None:
        if self._requests:
            self._requests[-1].is_open = False

    def _judge_pokes(self, snapshot: Snapshot, now_s: float, lines: list[AskedLine]) -> bool:
        """Add verdicts on final pokes; say whether the next target has to wait for one."""
        if self._judged_poke < 0:
            self._judged_poke = max((record.outcome.poke for record in snapshot.pokes), default=0)
        for record in _pokes_after(snapshot.pokes, self._judged_poke):
            outcome = record.outcome
            request = next((each for each in reversed(self._requests) if each.at_s <= outcome.start_s), None)
            if not outcome.final and now_s - outcome.end_s < POKE_VERDICT_TIMEOUT_S:
                return request is not None and request.is_open
            self._judged_poke = outcome.poke
            if request is not None and not request.is_judged:
                request.end()
                request.judged_s = now_s
                request.landmark = snapshot.at_landmarks.get(outcome.poke, "")
                is_driven = request.is_driven and not request.is_by_hand
                self._driven += [request.landmark] if request.landmark and is_driven else []
                lines.append(Judged(request.target.number, _why_rejected(record, snapshot)))
        newest = self._requests[-1] if self._requests else None
        if newest and newest.is_open and newest.reached_s is not None and now_s - newest.reached_s > POKE_DETECTION_TIMEOUT_S:
            newest.end()
            lines.append(Judged(newest.target.number, NOT_DETECTED))
        return False


def _pokes_after(pokes: Sequence[PokeRecord], number: int) -> Sequence[PokeRecord]:
    # They are at the end, after thousands of others.
    count = 0
    while count < len(pokes) and pokes[-1 - count].outcome.poke > number:
        count += 1
    return pokes[len(pokes) - count :]


def _why_rejected(record: PokeRecord, snapshot: Snapshot) -> str:
    """Reason why a poke, on the skin or at a landmark, does not count; empty if it counts."""
    outcome = record.outcome
    if outcome.poke in snapshot.decisions.missed_landmarks:
        return missed_words(snapshot.decisions.missed_landmarks[outcome.poke])
    if isinstance(outcome, Contact) or outcome.poke in snapshot.at_landmarks:
        return ""
    return rejection_words(outcome)

"""Detect pokes in samples: their begin and end, and their verdict.

The detector is in one of three states.

* *Untared*: it waits for a quiet window (phase TARING). The force is unknown, so no poke can begin.
* *Idle*: tared, nothing presses (READY). Every quiet window renews the tare, so slow drift never adds up.
* *Press*: the tared force rose above `touch_force` and is not yet below `release_force` (PRESSING, STILL, HELD).

A press ends with the first sample below `release_force`. Its poke is judged at once with the tare before it (`final=False`),
and again after the next quiet window, with the tare after it (`final=True`). Pokes without quiet between them share the tares
around them: the baseline is linear in time between two quiet windows. The first verdict becomes final if the second tare cannot
come: the arm moved, a device vanished, or nothing was quiet for `TARE_AGE_MAX_S`.

A force that never falls is the dangerous case: the load may have changed for good, by an arm that moved or a sensor that came
back with another offset.

* A turn of the arm, or of a tool that carries the sensor, drops the tare at once: the weight then acts in another direction.
* A steady press of `TARE_AGE_MAX_S` is rejected as "no quiet time to tare", and the tare is dropped.
* While untared, skin that answers against its last rest shows that something still leans on it, for `TARE_AGE_MAX_S` at most.
* Something that pressed from the first sample on is tared away. When it leaves, skin falls below its baseline. This drops the
  tare until a taxel has answered a poke. With a wrong polarity it looks alike: but then force and skin return to that tare.

The stream of the joints may pause: the arm may move unseen, or rest while a device sends changes only. A poke with late angles
is rejected as "arm pose unknown". If the next angles are the same, the arm rested, and the poke is judged again.

All results depend on the sequence of samples only, never on a clock.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Mapping, Set
from dataclasses import replace
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from skincal.contacts.answers_of_skin import answers_of
from skincal.contacts.channel_health import ChannelHealth
from skincal.contacts.gates import MAX_SAMPLE_GAP_IN_SKIN_PERIODS, answer_limit, finish, judge, largest_turn_during_poke
from skincal.contacts.outcome import CROWDED_REASONS, BeforePokes, Contact, Outcome, PressPhase, Progress, Reason, Rejection
from skincal.contacts.press import ArmPose, FinishedPress, Press, arm_turn_between
from skincal.contacts.skin_condition import SkinCondition, SkinWatch
from skincal.contacts.skin_drift import SkinDrift
from skincal.contacts.stream_offset import StreamOffsetWatch
from skincal.contacts.tare import TARE_AGE_MAX_S, Tare, TareKeeper
from skincal.contacts.value_order import ValueOrderCounts
from skincal.geometry import FloatArray, IntArray, axis_point, length_of, move_wrench
from skincal.model.readings import Sample, is_silent
from skincal.model.scene import ContactSettings, Scene
from skincal.streams.intervals import longest_interval_of_groups, usual_interval

SAMPLES_FOR_MEDIAN_PERIOD = 15
"""Samples whose median spacing is the period; enough to outvote a few missing frames."""
MAX_GAP_IN_GROUP_INTERVALS = 1.5
"""Times between two groups of frames, for frames that come in groups. A longer gap means that a group was lost."""

REST_MIN_S = 1.5
"""s. A tare that lasted longer before the first press was at rest: a session does not begin with so long a press."""


class ContactDetector:
    """Detector of the pokes of a session, or of the rest of one after a break.

    Parameters
    ----------
    last_poke : number of the last poke before the break
    dead : channels found to be dead before it, with the reason
    outcomes : pokes before it; those with a `press` are judged again when a dead channel is found
    range_end : raw value that was found before it to be the end of the skin's range; NaN for none
    """

    finds_touches_at_rest: ClassVar[bool] = False
    """Whether a sample without a press may bring an outcome."""

    def __init__(
        self,
        scene: Scene,
        last_poke: int = 0,
        dead: Mapping[int, str] = MappingProxyType({}),
        outcomes: Iterable[Outcome] = (),
        range_end: float = math.nan,
    ) -> None:
        layout = scene.skin.layout
        self._scene = scene
        self._thresholds = scene.contacts
        self._candidates: IntArray = np.arange(scene.skin.channels) if layout is None else layout.channels
        self._answers = answers_of(scene.skin)
        self._tares = self._make_tares(scene)
        self._health = ChannelHealth(scene, self._candidates, dead)
        self._drift = SkinDrift(self._candidates, scene.skin.frame_width, self._answers)
        self._watch = SkinWatch(scene, self._candidates, self._answers, range_end)
        self._offset = StreamOffsetWatch()
        self._at_top: dict[int, Contact] = {}
        """Contacts with taxels that may be at the end of the range."""
        self._ignored: Set[int] | None = None
        self._spacings: deque[float] = deque(maxlen=SAMPLES_FOR_MEDIAN_PERIOD)
        self._period_s, self._group_interval_s = 0.0, 0.0
        self._last: Sample | None = None
        self._untared_since = 0.0
        self._turn_max = largest_turn_during_poke(scene)
        self._joints = None if scene.arm is None else np.array(scene.arm.arm.joints, np.int64)
        self._arm_pose: ArmPose | None = None
        self._tare_pose: ArmPose | None = None
        self._has_answer = False
        self._rest_tare: Tare | None = None
        """Tare of the newest press that its taxels answered below their baseline, if it lasted as only rest does."""
        self._has_returned_to_rest = False
        self._press: Press | None = None
        self._pokes = last_poke
        self._pending: list[FinishedPress] = []
        self._with_late_angles: dict[int, tuple[FinishedPress, Tare | None]] = {}
        """Final pokes with late angles, and the tares after them; the next angles decide on them."""
        self._rejudged = {outcome.poke: outcome for outcome in outcomes if outcome.press is not None}
        # The time before the first poke.
        self._times_s: tuple[float, float] | None = None
        self._samples, self._strongest, self._gaps, self._longest_gap_s = 0, 0.0, 0, 0.0
        self._answered, self._fell = np.zeros((2, len(self._candidates)), dtype=bool)

    def _make_tares(self, scene: Scene) -> TareKeeper:
        return TareKeeper(scene.contacts, scene.skin.frame_width)

    @property
    def dead(self) -> Mapping[int, str]:
        """Channels found to be dead, with the reason."""
        return self._health.dead

    @property
    def condition(self) -> SkinCondition:
        """Condition of the skin so far."""
        return self._watch.condition(self._drift, self._offset.offset_s)

    @property
    def value_order(self) -> ValueOrderCounts | None:
        """See `SkinCondition`; it costs nothing."""
        return self._watch.value_order

    @property
    def responses(self) -> FloatArray:
        """(channels,) float, raw units: the last frame above its baseline; NaN before the first tare."""
        tare = self._tares.tare
        if self._last is None or tare is None:
            return np.full(self._scene.skin.channels, np.nan)
        return self._answers.responses(self._last.skin - self._drift.rest_at(tare, self._last.host_s))

    @property
    def is_pressing(self) -> bool:
        """Whether a press is in progress."""
        return self._press is not None

    @property
    def signals(self) -> tuple[float, float]:
        """Force, N, and answer of the strongest taxel, raw units, of the last sample above its tares; 0 before the first."""
        tare, responses = self._tares.tare, self.responses[self._candidates]
        if self._last is None or tare is None:
            return 0.0, 0.0
        return _force(self._last, tare), float(np.fmax.reduce(responses, initial=0.0))

    @property
    def last_s(self) -> float:
        """Time of the last sample, host clock; 0 before the first."""
        return 0.0 if self._last is None else self._last.host_s

    def feed(self, sample: Sample, link_from_sensor: FloatArray | None, pose: str) -> list[Outcome]:
        """Process one sample; return the pokes that ended with it or became final, in the order of their numbers.

        `link_from_sensor` is (4, 4) float, metres, `None` while the arm's pose is unknown; `pose` is its name.
        """
        if not all(map(math.isfinite, sample.wrench.tolist())):
            # NaN would spoil every mean; a saturated sample is counted, and its poke is rejected.
            sample = replace(sample, wrench=np.zeros(6), saturated=True)
        watched = self._answers.watched(sample.skin)
        self._watch.on_frame(watched)
        self._offset.add(sample.host_s, sample.wrench[:3], watched)
        arm_pose = self._arm_pose = self._pose_now(sample, link_from_sensor, pose)
        gap_s = self._gap_before(sample)
        self._last = sample
        outcomes = self._rejudge_late_angles(sample, arm_pose)
        outcomes += self._rejudge() if self._health.on_frame(sample.host_s, watched) and self._ignored is None else []
        tare = self._tares.tare
        if self._press is not None:
            outcomes += self._feed_press(self._press, sample, arm_pose, gap_s)
        else:
            outcomes += self._feed_idle(sample, arm_pose, gap_s)
        if not self._pokes:
            self._note_before_pokes(sample, tare, gap_s)
        # Pokes that waited too long become final, so that the list of pending pokes stays short.
        while self._pending and sample.host_s - self._pending[0].end_s > TARE_AGE_MAX_S:
            outcomes.append(self._judge(self._pending.pop(0), None, final=True))
        return outcomes

    @property
    def before_pokes(self) -> BeforePokes:
        """Summary of the samples before the first poke."""
        first_s, last_s = self._times_s or (0.0, 0.0)
        fell, tared = self._fell & ~self._answered, self._tares.rest_skin is not None
        answered, fallen = int(self._answered.sum()), int(fell.sum())
        return BeforePokes(
            self._samples, last_s - first_s, tared, self._strongest, answered, fallen, self._gaps, self._longest_gap_s
        )

    def reset(self, host_s: float | None = None, *, is_loss: bool = True) -> list[Outcome]:
        """Start again after a break at `host_s`, or at the last sample: a device was lost, or a recording ended.

        A poke in progress ends: as "readings lost" if the break `is_loss` or the samples were silent (`is_silent`) before it,
        else it is judged by its readings. Pending pokes become final, and the tare is dropped. Numbers go on.
        """
        outcomes: list[Outcome] = []
        if (press := self._press) is not None:
            end_s = self.last_s if host_s is None else host_s
            # The newest samples may still be on their way at the end of a session: of a group, or without their wrench.
            lost = end_s - self.last_s if is_loss or is_silent(self.last_s, end_s) else 0.0
            if is_loss:
                # Just over the limit at least: the break itself is the loss, however soon it is known.
                lost = max(lost, MAX_SAMPLE_GAP_IN_SKIN_PERIODS * self._period_s * (1 + 1e-9))
            press.note_gap(lost)
            outcomes += self._end(press)
        outcomes += self._finalize_pending(None)
        self._drop_tare(self.last_s)
        self._spacings.clear()
        self._last = None
        return outcomes

    def use_thresholds(self, thresholds: ContactSettings) -> None:
        """Use these thresholds for pokes that begin from now on. Earlier pokes keep theirs."""
        self._thresholds = thresholds
        self._tares.quiet_s = thresholds.quiet_s

    def ignore_channels(self, channels: Set[int]) -> list[Outcome]:
        """Ignore these channels from now on, in place of the automatically found dead channels.

        Returns earlier pokes whose verdict changes.
        """
        if self._ignored is not None and channels == self._ignored:
            return []
        self._ignored = frozenset(channels)
        return self._rejudge()

    def progress(self, link_from_sensor: FloatArray | None) -> Progress:
        """Describe the poke in progress; its force axis is in the link frame, in the sensor frame while the pose is unknown."""
        press = self._press
        force, moment = np.zeros(3), np.zeros(3)
        if press is not None and self._last is not None and not self._last.saturated:
            wrench = self._last.wrench - press.tare.wrench
            force, moment = move_wrench(np.eye(4) if link_from_sensor is None else link_from_sensor, wrench[:3], wrench[3:])
        responses = self.responses
        channels = self._answering(responses)
        return Progress(
            phase=self.phase,
            force=force,
            axis_point=axis_point(force, moment) if force @ force > 0.0 else np.zeros(3),
            channels=channels,
            responses=responses[channels],
            still=0.0 if press is None else min(1.0, press.still),
        )

    def awaits_outcome(self, *, final: bool) -> bool:
        """Whether a poke is in progress or waits for the tare or angles after it; only the latter if the outcome is `final`."""
        return self.finds_touches_at_rest or bool(self._pending or self._with_late_angles) or not (final or self._press is None)

    @property
    def phase(self) -> PressPhase:
        """State of the detector: waiting, or the progress of a poke."""
        tare, press = self._tares.tare, self._press
        if self._last is None:
            return PressPhase.NO_DATA
        if tare is None or (press is None and self._last.host_s - tare.end_s > TARE_AGE_MAX_S):
            return PressPhase.TARING
        if press is None:
            return PressPhase.READY
        if press.may_release:
            return PressPhase.HELD
        is_hard = float(np.linalg.norm(press.force)) >= press.settings.force_min
        # Two samples are always alike; a quarter of the window says something.
        return PressPhase.STILL if is_hard and press.still >= 0.25 else PressPhase.PRESSING

    def _note_before_pokes(self, sample: Sample, tare: Tare | None, gap_s: float) -> None:
        """Note a sample before the first poke, with the tare at it and the gap before it."""
        self._gaps += gap_s > 0
        self._longest_gap_s = max(self._longest_gap_s, gap_s)
        self._times_s = (sample.host_s if self._times_s is None else self._times_s[0]), sample.host_s
        self._samples += 1
        if tare is None or sample.saturated:
            return
        self._strongest = max(self._strongest, _force(sample, tare))
        above, below = self._beyond_limit(sample, tare)
        # The first direction counts: a soft steady touch is tared away, and its end has the other direction.
        self._answered |= above & ~self._fell
        self._fell |= below & ~self._answered

    def _pose_now(self, sample: Sample, link_from_sensor: FloatArray | None, name: str) -> ArmPose:
        """Give the arm's pose; the same object while the arm does not move."""
        before = self._arm_pose
        angles = None if self._joints is None or sample.angles is None else sample.angles.take(self._joints)
        if before is not None and before.link_from_sensor is link_from_sensor and before.name == name:
            known = before.angles
            if known is angles or (known is not None and angles is not None and known.tolist() == angles.tolist()):
                return before
        return ArmPose(link_from_sensor, name, angles)

    def _gap_before(self, sample: Sample) -> float:
        """Compute the gap before this sample, s, 0 without one; update the sample period."""
        if self._last is None:
            return 0.0
        step = sample.host_s - self._last.host_s
        known = self._period_s
        if step > 0:
            self._spacings.append(step)  # a gap too: a device that became slower has one gap after the other
            if len(self._spacings) >= 3 and self._press is None:
                self._period_s = usual_interval(self._spacings)
                self._group_interval_s = longest_interval_of_groups(self._spacings)
        # Time that stands still or goes back is a gap, too. One between two groups of frames is none.
        limit_s = max(MAX_SAMPLE_GAP_IN_SKIN_PERIODS * known, MAX_GAP_IN_GROUP_INTERVALS * self._group_interval_s)
        return abs(step) if known > 0 and not 0 < step <= limit_s else 0.0

    def _feed_idle(self, sample: Sample, pose: ArmPose, gap_s: float) -> list[Outcome]:
        outcomes: list[Outcome] = []
        if gap_s > 0:
            self._tares.interrupt()  # a quiet window consists of successive samples
        if self._tare_pose is not None and self._arm_moved(self._tare_pose, pose):
            outcomes += self._finalize_pending(None)
            self._drop_tare(sample.host_s)
        if sample.saturated:
            self._tares.interrupt()
            return outcomes
        tare = self._tares.tare
        if tare is not None and _force(sample, tare) >= self._thresholds.touch_force:
            before = self._tares.before(sample.host_s) or tare
            self._tares.interrupt()
            # With the pose of the tare: an arm that turned since then turned under the poke.
            self._press = Press(self._thresholds, before, sample, self._tare_pose or pose, self._period_s)
            self._press.add(sample, pose)
            return outcomes
        return outcomes + self._feed_rest(sample, pose)

    def _feed_rest(self, sample: Sample, pose: ArmPose) -> list[Outcome]:
        """Process a sample while nothing presses; return the pokes that became final by a new tare."""
        if self._tares.tare is None and self._is_still_touched(sample):
            self._tares.interrupt()
            return []
        new = self._tares.feed(sample, self._period_s)
        if new is None:
            return []
        self._tare_pose = pose
        return self._finalize_pending(new)

    def _feed_held(self, press: Press, sample: Sample, pose: ArmPose) -> list[Outcome]:
        """Process a sample of a press that goes on; reject one that is too long for its tare."""
        press.add(sample, pose)
        if sample.host_s - press.start_s > TARE_AGE_MAX_S and press.is_steady:
            return self._reject_untared(press, sample, sample.host_s - press.tare.end_s, TARE_AGE_MAX_S)
        return []

    def _feed_press(self, press: Press, sample: Sample, pose: ArmPose, gap_s: float) -> list[Outcome]:
        if gap_s > 0:
            press.note_gap(gap_s)
        if self._arm_moved(press.pose, pose, press.note_pose(pose)):
            outcomes = [*self._end(press), *self._finalize_pending(None)]
            self._drop_tare(sample.host_s)
            return outcomes
        if not sample.saturated and _force(sample, press.tare) < press.settings.release_force:
            outcomes = self._end(press)
            # The sample that shows the release is the first of the quiet time after it.
            self._tares.feed(sample, self._period_s)
            return outcomes
        if outcomes := self._feed_held(press, sample, pose):
            return outcomes
        if not self._has_answer and press.is_steady and self._was_tared_while_pressed(press, sample):
            first_s = press.start_s if self._times_s is None else self._times_s[0]
            is_rest = self._has_returned_to_rest or press.start_s - max(first_s, self._untared_since) > REST_MIN_S
            self._rest_tare = press.tare if is_rest else None
            return self._reject_untared(press, sample, 0.0, self._thresholds.quiet_s) + self._rest_since(press)
        if not self._has_answer and press.is_steady and self._is_back_at_rest(sample):
            # Against the polarity each press is taken for rest, and its release for a press.
            self._press, self._rest_tare, self._has_returned_to_rest = None, None, True
            self._drop_tare(sample.host_s)
            return self._rest_since(press)
        return []

    def _rest_since(self, press: Press) -> list[Outcome]:
        """Take the steady samples of a press for the quiet time that was missing."""
        self._tares.forget_rest()
        return [outcome for item, pose in press.latest for outcome in self._feed_idle(item, pose, 0.0)]

    def _is_back_at_rest(self, sample: Sample) -> bool:
        """Whether force and skin are again as before a press that taxels answered below their baseline."""
        tare = self._rest_tare
        if tare is None or _force(sample, tare) >= self._thresholds.release_force:
            return False
        above, below = self._beyond_limit(sample, tare)
        return not (above.any() or below.any())

    def _was_tared_while_pressed(self, press: Press, sample: Sample) -> bool:
        """Whether the skin was pressed during its tare: some channels are below their baseline, none above."""
        above, below = self._beyond_limit(sample, press.tare)
        return bool(below.any()) and not above.any()

    def _beyond_limit(self, sample: Sample, tare: Tare) -> tuple[np.ndarray, np.ndarray]:
        """(c,) bool each: candidates that are above and below their baseline by more than their limit."""
        rest = self._drift.rest_at(tare, sample.host_s)
        response = self._answers.responses(sample.skin - rest)[self._candidates]
        limit = answer_limit(self._thresholds, self._noise)[self._candidates]
        return response > limit, response < -limit

    def _reject_untared(self, press: Press, sample: Sample, value: float, limit: float) -> list[Outcome]:
        """Reject the press because its tare is unusable: too old, or taken while something pressed."""
        self._press = None
        self._pokes += 1
        rejection = Rejection(
            poke=self._pokes,
            start_s=press.start_s,
            end_s=sample.host_s,
            reason=Reason.NO_TARE,
            value=value,
            limit=limit,
            unit="s",
            channels=np.empty(0, dtype=np.int64),
            final=True,
            pose="" if self._scene.tool is None else self._scene.tool.arm_pose,
        )
        outcomes = [*self._finalize_pending(None), rejection]
        self._drop_tare(sample.host_s)
        return outcomes

    def _end(self, press: Press) -> list[Outcome]:
        self._press = None
        self._pokes += 1
        poke = finish(self._pokes, press, self._scene, self._noise, self._period_s, self._drift)
        self._pending.append(poke)
        self._has_answer = self._has_answer or len(poke.channels) > 0
        changed = self._health.on_poke(poke)
        outcomes = self._rejudge() if changed and self._ignored is None else []
        if self._watch.on_press(poke, self._noise, answer_limit(self._thresholds, self._noise)):
            outcomes += self._mark_clipped()
        return [*outcomes, self._judge(poke, None, final=False)]

    def _finalize_pending(self, after: Tare | None) -> list[Outcome]:
        """Make the pending pokes final, with the tare after them or without one."""
        pending, self._pending = self._pending, []
        outcomes: list[Outcome] = []
        for place, press in enumerate(pending):
            pending[place] = judged = self._drift.judge(press, after)
            if judged is not press and self._health.on_other_answers(press, judged) and self._ignored is None:
                outcomes += self._rejudge()
        return [*outcomes, *(self._judge(poke, after, final=True) for poke in pending)]

    def _judge(self, press: FinishedPress, after: Tare | None, *, final: bool) -> Outcome:
        if press.late is not None and not press.late.moved and final:
            self._with_late_angles[press.number] = press, after
        outcome = judge(press, self._scene, after, final, self._ignored_now())
        if isinstance(outcome, Contact) and len(press.at_top):
            outcome = self._at_top[press.number] = self._with_clipped(outcome)
        if _is_crowded(outcome):
            outcome = replace(outcome, press=press.without_frames(), tare_after=after)
            if final:
                self._rejudged[press.number] = outcome
        return outcome

    def _with_clipped(self, contact: Contact) -> Contact:
        """Mark the answers of a contact that are at the end of the skin's range."""
        found = self._watch.clipped(contact.poke)
        clipped = None if found is None else found[np.isin(found, contact.channels)]
        return replace(contact, clipped=None if clipped is None or not len(clipped) else clipped)

    def _mark_clipped(self) -> list[Outcome]:
        """Mark earlier contacts after the end of the range became known, or another value; return those that change."""
        changed: list[Outcome] = []
        for poke, before in self._at_top.items():
            now = self._at_top[poke] = self._with_clipped(before)
            if (now.clipped is None) != (before.clipped is None):
                changed.append(now)
        return changed

    def _rejudge_late_angles(self, sample: Sample, pose: ArmPose) -> list[Outcome]:
        """Judge pokes with late angles by the first angles after them; return those that now count."""
        if sample.has_late_angles or pose.angles is None or not (self._with_late_angles or self._pending):
            return []
        ended, self._with_late_angles = self._with_late_angles, {}
        outcomes: list[Outcome] = []
        for press, after in ended.values():
            decided = self._decide_late_angles(press, sample.angles_s, pose.angles)
            if decided is press:
                self._with_late_angles[press.number] = press, after
            elif decided.late is None:
                outcomes.append(self._judge(decided, after, final=True))
        for place, press in enumerate(self._pending):
            self._pending[place] = decided = self._decide_late_angles(press, sample.angles_s, pose.angles)
            if decided is not press and decided.late is None:
                outcomes.append(self._judge(decided, None, final=False))
        return outcomes

    def _decide_late_angles(self, press: FinishedPress, angles_s: float, angles: FloatArray) -> FinishedPress:
        """Decide by newer angles whether the arm moved since those of a press; they decide nothing if they are not newer."""
        late, arm = press.late, self._scene.arm
        if late is None or late.moved or arm is None or angles_s <= late.angles_s:
            return press
        has_moved = bool(np.abs(angles - late.angles).max(initial=0.0) > arm.turn_max)
        return replace(press, late=replace(late, moved=True) if has_moved else None)

    def _rejudge(self) -> list[Outcome]:
        """Judge pokes again after the dead channels changed; return those whose verdict changes."""
        changed: list[Outcome] = []
        for number, before in sorted(self._rejudged.items()):
            press, after = before.press, before.tare_after
            assert press is not None
            outcome = judge(press, self._scene, after, True, self._ignored_now())
            if _is_crowded(outcome) != _is_crowded(before):
                self._rejudged[number] = replace(outcome, press=press, tare_after=after)
                changed.append(self._rejudged[number])
        return changed

    @property
    def _noise(self) -> FloatArray:
        """(channels,) float, raw units: noise of the responses at rest."""
        return self._answers.noise(self._tares.noise)

    def _ignored_now(self) -> Set[int]:
        return self._health.dead.keys() if self._ignored is None else self._ignored

    def _arm_moved(self, before: ArmPose, now: ArmPose, turn: float | None = None) -> bool:
        """Whether the arm turned beyond its tolerance; `turn`, rad, if it is known already."""
        if self._turn_max is None:
            return False
        became_known = (before.link_from_sensor is None) != (now.link_from_sensor is None)
        turn = arm_turn_between(before, now) if turn is None else turn
        return became_known or turn > self._turn_max

    def _drop_tare(self, host_s: float) -> None:
        self._tares.drop()
        self._tare_pose = None
        self._untared_since = host_s

    def _is_still_touched(self, sample: Sample) -> bool:
        """Whether something still presses: the skin differs from its last values at rest."""
        rest = self._tares.rest_skin
        if rest is None or sample.host_s - self._untared_since > TARE_AGE_MAX_S:
            return False
        return len(self._answering(self._answers.responses(sample.skin - rest))) > 0

    def _answering(self, responses: FloatArray) -> IntArray:
        """Channels in use whose response, (channels,), is above their limit; NaN is not."""
        above = (responses > answer_limit(self._thresholds, self._noise))[self._candidates]
        ignored = self._ignored_now()
        return np.array([channel for channel in self._candidates[above].tolist() if channel not in ignored], dtype=np.int64)


def _is_crowded(outcome: Outcome) -> bool:
    return isinstance(outcome, Rejection) and outcome.reason in CROWDED_REASONS


def _force(sample: Sample, tare: Tare) -> float:
    return length_of(sample.wrench[:3] - tare.wrench[:3])

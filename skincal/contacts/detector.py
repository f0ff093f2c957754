"""From samples to pokes: when one begins and ends, what it ends as, and which channels cannot be trusted.

*Channels.* One that gives no number, is stuck or always on is dead while the cause lasts: one that moves again, or gives
numbers again, is used again.

*Pokes.* The detector is in one of three situations.

* *Untared*: it waits for a quiet window (phase TARING). No force is known, so no poke can begin.
* *Idle*: tared, nothing presses (READY). Every quiet window renews the tare, so slow drift never builds up.
* *Press*: the tared force rose above `touch_force` and has not yet fallen below `release_force` (PRESSING, STILL, HELD).

A release ends the press in the very sample that shows it: the poke is judged with the tare before it and emitted
(`final=False`). It then waits for the next quiet window, which gives the tare after it, and is emitted once more
(`final=True`). Pokes without quiet between them share the tares around them: the baseline is linear in time between
two quiet windows, whatever happened in between. Where the second tare cannot come (the arm moved, a device vanished, nothing
was quiet for `TARE_AGE_MAX_S`) the first judgement is made final.

The force that never falls is the dangerous case, since the load may have changed for good: an arm that moved, a sensor
that came back with another offset. A turn of the arm drops the tare at once. A press that lasts for
`TARE_AGE_MAX_S` and is steady ends as "no quiet time to tare", and the tare is dropped too. While untared, skin that
answers against its last known rest says that something still leans there; that holds for `TARE_AGE_MAX_S` at most. At the start
no rest is known: something that pressed from the first sample on is tared away, and shows when it leaves, by skin that falls
below its baseline. Until a taxel has answered a poke, that drops the tare.

Everything depends on the sequence of samples alone, never on a clock.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from statistics import median
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skincal.contacts.gates import GAP_PERIODS, FinishedPress, answer_limit, finish, judge
from skincal.contacts.outcome import BeforePokes, Outcome, PressPhase, Progress, Reason, Rejection
from skincal.contacts.press import ArmPose, Press, turned
from skincal.contacts.tare import TARE_AGE_MAX_S, Tare, TareKeeper
from skincal.geometry import FloatArray, IntArray, axis_point, length_of, move_wrench
from skincal.model.readings import Sample
from skincal.model.scene import ContactSettings, Scene

NO_NUMBER_S = 2.0
"""s. A channel that gives no number for so long is dead: a hundred frames at 50 Hz."""
STUCK_END_S = TARE_AGE_MAX_S
"""s. A channel that rests at the pressed end of its range for so long is stuck: longer than any poke that counts."""
STUCK_S = 60.0
"""s. A channel that keeps one exact value for so long on a skin that is never at rest is stuck."""
RESTLESS = 0.75
"""Share of the frames in which the typical channel changes, on a skin that is never at rest: its noise is a raw unit and
more. On a coarser skin a good channel may rest exactly for minutes."""
STUCK_NEAR_POKES = 6
"""Pokes whose strongest taxel is a neighbour, without the slightest change of this one, that make it stuck."""
AWAY_POKES = 5
"""Pokes elsewhere that a channel must have answered to be always on."""
AWAY_SHARE = 0.6
"""Share of the pokes elsewhere that a channel must have answered to be always on."""
BLIND_POKES = 10
"""Without a layout, nothing is known to be elsewhere: pokes before a channel may be called always on."""
BLIND_PEAKS = 5
"""Different strongest taxels that there must be among those pokes."""
BLIND_SHARE = 0.8
"""Share of all pokes that a channel must have answered to be always on, without a layout."""
CROWD = 32
"""Answers. A poke with more, such as a palm, says nothing about single channels."""
FRESH_MOST = 256
"""Frames that wait to be counted, at most: at 50 Hz they are counted after a second."""
NEIGHBOUR = 1.2
"""Spacings of the layout between direct neighbours, at most."""
# How the sentence on each kind begins.
_NO_NUMBER, _STUCK, _ALWAYS_ON = "gives no number", "stuck", "always on"


class ChannelHealth:
    """Watches every frame and every poke of the taxels `candidates` (c,).

    What was `known` before a break, with the reason, holds until the channel shows otherwise.
    """

    def __init__(self, scene: Scene, candidates: IntArray, known: Mapping[int, str] = MappingProxyType({})) -> None:
        channels = scene.skin.channels
        self._candidates = candidates
        self._far = None if scene.skin.layout is None else 2.0 * scene.contacts.gap_factor * scene.skin.layout.spacing
        self._places = None if scene.skin.layout is None else scene.skin.layout.places[candidates]
        self._near = 0.0 if scene.skin.layout is None else NEIGHBOUR * scene.skin.layout.spacing
        self._end = None if scene.skin.range is None else scene.skin.range[1 if scene.skin.polarity > 0 else 0]
        self._last: FloatArray | None = None
        # Frames since then, with their times: many at once are counted in the time of a few.
        self._fresh: list[tuple[float, FloatArray]] = []
        self._changed_s = np.zeros(channels)
        self._number_s = np.zeros(channels)
        self._changes = np.zeros(channels, dtype=np.int64)
        self._varied = np.zeros(channels, dtype=bool)
        self._frames = 0
        self._near_pokes = np.zeros(channels, dtype=np.int64)
        self._answered = np.zeros(len(candidates), dtype=np.int64)
        self._away = np.zeros(len(candidates), dtype=np.int64)
        self._away_answered = np.zeros(len(candidates), dtype=np.int64)
        self._pokes = 0
        self._peaks: set[int] = set()
        self._looked_s = -np.inf
        self._known = dict(known)
        self.dead: Mapping[int, str] = known
        """Channels that are not to be used, with the reason; a new mapping whenever it changes."""

    def feed(self, host_s: float, skin: FloatArray) -> bool:
        """Take one frame; return whether `dead` changed. It is looked at once a second."""
        if self._last is None:
            self._changed_s[:] = self._number_s[:] = host_s
            self._last = skin
            self._looked_s = host_s
            return False
        self._fresh.append((host_s, skin))
        if len(self._fresh) == FRESH_MOST:
            self._catch_up()
        return host_s - self._looked_s >= 1.0 and self._look(host_s)

    def _catch_up(self) -> None:
        """Count what changed in the frames that were only kept so far."""
        if self._last is None or not self._fresh:
            return
        times_s, frames = zip(*self._fresh, strict=True)
        self._fresh.clear()
        skin = np.array([self._last, *frames])
        moved = skin[1:] != skin[:-1]  # NaN differs from everything; it has a clock of its own, `_number_s`
        number = ~np.isnan(skin)
        _set_last(self._changed_s, times_s, moved)
        _set_last(self._number_s, times_s, number[1:])
        self._changes += moved.sum(axis=0)
        self._varied |= (moved & number[1:] & number[:-1]).any(axis=0)
        self._frames += len(frames)
        self._near_pokes[moved.any(axis=0)] = 0
        self._last = skin[-1]

    def poke(self, host_s: float, channels: IntArray, responses: FloatArray) -> bool:
        """Take the answers of one poke, whatever it ended as; return whether `dead` changed."""
        if not 0 < len(channels) <= CROWD:
            return False
        self._catch_up()
        peak = int(channels[np.argmax(responses)])
        answered = np.isin(self._candidates, channels)
        self._pokes += 1
        self._peaks.add(peak)
        self._answered += answered
        if self._places is not None and self._far is not None:
            away = self._others_distance(answered) > self._far
            self._away += away
            self._away_answered += away & answered
            beside = np.linalg.norm(self._places - self._places[self._candidates == peak], axis=1) <= self._near
            self._near_pokes[self._candidates[beside & ~answered]] += 1
        return self._look(host_s)

    def _others_distance(self, answered: np.ndarray) -> FloatArray:
        """(c,) distance of each candidate to the nearest other one that answered; 0 where there is no other."""
        assert self._places is not None
        places = self._places[answered]
        distance = np.linalg.norm(self._places[:, None] - places[None], axis=-1)
        # A taxel is not another one of those that answered.
        distance[np.flatnonzero(answered), np.arange(len(places))] = np.inf
        nearest = distance.min(axis=1)
        return np.where(np.isfinite(nearest), nearest, 0.0)

    def _look(self, host_s: float) -> bool:
        """Judge every channel; return whether `dead` changed."""
        self._catch_up()
        self._looked_s = host_s
        # Where several causes fit, the last one that is found gives the sentence: the plainest comes last.
        dead: dict[int, str] = {}
        self._find_always_on(dead)
        self._find_stuck(host_s, dead)
        self._find_numberless(host_s, dead)
        self._known = {channel: why for channel, why in self._known.items() if self._holds(channel, why)}
        dead = self._known | dead
        dead = {channel: dead[channel] for channel in sorted(dead)}
        # Another number in a sentence is no news.
        if dead.keys() == self.dead.keys():
            return False
        self.dead = dead
        return True

    def _holds(self, channel: int, why: str) -> bool:
        """Return whether what was found before the break still holds: nothing since has shown otherwise."""
        if self._last is None or channel >= len(self._last):
            return self._last is None
        if why.startswith(_NO_NUMBER):
            return bool(np.isnan(self._last[channel]))
        if not why.startswith(_ALWAYS_ON):
            return not self._varied[channel]
        if self._places is None:
            return self._pokes < BLIND_POKES or len(self._peaks) < BLIND_PEAKS
        return bool((self._away[self._candidates == channel] < AWAY_POKES).any())

    def _find_numberless(self, host_s: float, dead: dict[int, str]) -> None:
        without = host_s - self._number_s[self._candidates] >= NO_NUMBER_S
        for channel in self._candidates[without]:
            dead[int(channel)] = f"{_NO_NUMBER} for {NO_NUMBER_S:g} s or more; check its wiring"

    def _find_stuck(self, host_s: float, dead: dict[int, str]) -> None:
        assert self._last is not None
        rest = host_s - self._changed_s[self._candidates]
        value = self._last[self._candidates]
        # Only on a skin whose typical channel changes in most frames does an exact rest mean anything.
        restless = float(np.median(self._changes[self._candidates])) >= RESTLESS * self._frames
        for channel in self._candidates[(rest >= STUCK_S) & restless]:
            dead[int(channel)] = f"{_STUCK}: exactly {self._last[channel]:g} for {STUCK_S:g} s or more while the others vary"
        for channel in self._candidates[self._near_pokes[self._candidates] >= STUCK_NEAR_POKES]:
            dead[int(channel)] = (
                f"{_STUCK}: exactly {self._last[channel]:g} through {STUCK_NEAR_POKES} pokes or more on its neighbours"
            )
        if self._end is not None:
            for channel in self._candidates[(rest >= STUCK_END_S) & (value == self._end)]:
                dead[int(channel)] = f"{_STUCK} at {self._end:g}, the pressed end of its range, for {STUCK_END_S:g} s or more"

    def _find_always_on(self, dead: dict[int, str]) -> None:
        if self._places is not None:
            always = (self._away_answered >= AWAY_POKES) & (self._away_answered >= AWAY_SHARE * self._away)
            for index in np.flatnonzero(always):
                dead[int(self._candidates[index])] = (
                    f"{_ALWAYS_ON}: answered {self._away_answered[index]} of {self._away[index]} pokes that lie elsewhere"
                )
        elif self._pokes >= BLIND_POKES and len(self._peaks) >= BLIND_PEAKS:
            for index in np.flatnonzero(self._answered >= BLIND_SHARE * self._pokes):
                dead[int(self._candidates[index])] = (
                    f"{_ALWAYS_ON}: answered {self._answered[index]} of {self._pokes} pokes at {len(self._peaks)} places"
                )


def _set_last(times_s: FloatArray, frames_s: Sequence[float], where: NDArray[np.bool_]) -> None:
    """Give each of (c,) times the time of the last of n frames in which it is marked, in `where` (n, c), if there is one."""
    last = len(where) - 1 - where[::-1].argmax(axis=0)
    marked = where.any(axis=0)
    times_s[marked] = np.array(frames_s)[last[marked]]


# Samples whose median spacing is the period; enough to outvote a few missing frames.
_PERIOD_SAMPLES = 15
# Reasons that may fall away once a channel is found to be dead.
_CROWDED = (Reason.TOO_MANY_TAXELS, Reason.NOT_CONNECTED)


class Doubt(NamedTuple):
    """A poke that dead channels may have spoilt, with all it takes to judge it again once more is known of them."""

    poke: FinishedPress
    after: Tare | None


@dataclass(frozen=True, slots=True)
class Known:
    """What a session knows already where a detector takes it up."""

    pokes: int = 0
    """Number of the last poke."""
    dead: Mapping[int, str] = field(default_factory=dict[int, str])
    """Channels found to be dead, with the reason."""
    doubts: Sequence[tuple[Doubt, Outcome]] = ()
    """In the order of their numbers, each with how it was judged last."""


class ContactDetector:
    """The pokes of one session, or of what follows a break in one."""

    def __init__(self, scene: Scene, known: Known | None = None) -> None:
        known = known or Known()
        layout = scene.skin.layout
        self._scene = scene
        self._thresholds = scene.contacts
        self._candidates: IntArray = np.arange(scene.skin.channels) if layout is None else layout.channels
        self._tares = TareKeeper(scene.contacts, scene.skin.channels)
        self._health = ChannelHealth(scene, self._candidates, known.dead)
        self._unused: Set[int] | None = None
        self._spacings: deque[float] = deque(maxlen=_PERIOD_SAMPLES)
        self._period_s = 0.0
        self._last: Sample | None = None
        self._untared_since = 0.0
        self._joints = None if scene.arm is None else np.array(scene.arm.arm.joints, np.int64)
        self._arm_pose: ArmPose | None = None
        self._tare_pose: ArmPose | None = None
        self._rest_seen = False
        self._press: Press | None = None
        self._pokes = known.pokes
        self._pending: list[FinishedPress] = []
        self._doubts = {doubt.poke.number: (doubt, outcome) for doubt, outcome in known.doubts}
        # Of the time before the first poke.
        self._times_s: tuple[float, float] | None = None
        self._samples, self._strongest = 0, 0.0
        self._answered, self._fell = np.zeros((2, len(self._candidates)), dtype=bool)
        # The last frame and its baseline.
        self._answer: tuple[FloatArray, FloatArray] | None = None

    @property
    def dead(self) -> Mapping[int, str]:
        """Channels found to be dead, with the reason."""
        return self._health.dead

    @property
    def responses(self) -> FloatArray:
        """(channels,) float, raw units: the last frame above its baseline; NaN before the first tare."""
        if self._answer is None:
            return np.full(self._scene.skin.channels, np.nan)
        frame, baseline = self._answer
        return self._scene.skin.polarity * (frame - baseline)

    @property
    def last_s(self) -> float:
        """Time of the last sample, host clock; 0 before the first."""
        return 0.0 if self._last is None else self._last.host_s

    def feed(self, sample: Sample, link_from_sensor: FloatArray | None, pose: str) -> list[Outcome]:
        """Take one sample; return the pokes that ended with it, and those that became final, in the order of their numbers.

        `link_from_sensor` is (4, 4) float, metres, None while the arm's pose is unknown; `pose` is its name.
        """
        if not all(map(math.isfinite, sample.wrench.tolist())):
            # NaN would spoil every mean; a saturated sample is counted, and its poke is rejected.
            sample = replace(sample, wrench=np.zeros(6), saturated=True)
        arm_pose = self._arm_pose = self._pose_now(sample, link_from_sensor, pose)
        gap_s = self._hole(sample)
        self._last = sample
        outcomes = self._rejudge() if self._health.feed(sample.host_s, sample.skin) and self._unused is None else []
        tare = self._tares.tare
        if tare is not None:
            self._answer = sample.skin, tare.skin
        if self._press is not None:
            outcomes += self._pressing(self._press, sample, arm_pose, gap_s)
        else:
            outcomes += self._idle(sample, arm_pose, gap_s)
        if not self._pokes:
            self._watch(sample, tare)
        return outcomes + self._expire(sample.host_s)

    @property
    def before_pokes(self) -> BeforePokes:
        """What the samples until the first poke showed."""
        first_s, last_s = self._times_s or (0.0, 0.0)
        fell, tared = self._fell & ~self._answered, self._tares.resting is not None
        return BeforePokes(self._samples, last_s - first_s, tared, self._strongest, int(self._answered.sum()), int(fell.sum()))

    def reset(self, host_s: float | None = None) -> list[Outcome]:
        """Begin anew after a break at `host_s`, or at the last sample: a device vanished, or a recording is continued.

        A poke in progress ends as "readings lost", those that wait become final, and the tare is dropped. Numbers go on.
        """
        outcomes: list[Outcome] = []
        press = self._press
        if press is not None:
            # A hair over the limit at least: the break itself is the loss, however soon it is known.
            lost = 0.0 if host_s is None else host_s - self.last_s
            press.lose(max(lost, GAP_PERIODS * self._period_s * (1 + 1e-9)))
            outcomes += self._end(press)
        outcomes += self._settle(None)
        self._drop_tare(self.last_s)
        self._spacings.clear()
        self._last = None
        return outcomes

    def use_thresholds(self, thresholds: ContactSettings) -> None:
        """Detect and judge pokes that begin from now on by these; what began before keeps those that held then."""
        self._thresholds = thresholds
        self._tares.quiet_s = thresholds.quiet_s

    def use_all_but(self, channels: Set[int]) -> list[Outcome]:
        """Leave out the answers of `channels` from now on, instead of those found to be dead.

        Returns earlier pokes with too many or unconnected answers that are judged otherwise now.
        """
        if self._unused is not None and channels == self._unused:
            return []
        self._unused = frozenset(channels)
        return self._rejudge()

    def doubt(self, outcome: Outcome) -> Doubt | None:
        """Return what a poke is judged by again when another channel is found to be dead; None where that changes nothing."""
        if outcome.poke in self._doubts:
            return self._doubts[outcome.poke][0]
        if not _is_crowded(outcome):
            return None
        return next((Doubt(poke, None) for poke in self._pending if poke.number == outcome.poke), None)

    def progress(self, link_from_sensor: FloatArray | None) -> Progress:
        """Return the poke in progress, its force axis in the link frame (the sensor frame while the pose is unknown)."""
        press = self._press
        force, moment = np.zeros(3), np.zeros(3)
        if press is not None and self._last is not None and not self._last.saturated:
            wrench = self._last.wrench - press.tare.wrench
            force, moment = move_wrench(np.eye(4) if link_from_sensor is None else link_from_sensor, wrench[:3], wrench[3:])
        pressing = bool(force @ force > 0.0)
        responses = self.responses
        channels = self._answering(responses)
        return Progress(
            phase=self.phase,
            force=force,
            axis_point=axis_point(force, moment) if pressing else np.zeros(3),
            channels=channels,
            responses=responses[channels],
            still=0.0 if press is None else min(1.0, press.still),
        )

    @property
    def phase(self) -> PressPhase:
        """What it waits for, or how far a poke is."""
        tare, press = self._tares.tare, self._press
        if self._last is None:
            return PressPhase.NO_DATA
        if tare is None or (press is None and self._last.host_s - tare.end_s > TARE_AGE_MAX_S):
            return PressPhase.TARING
        if press is None:
            return PressPhase.READY
        if press.held:
            return PressPhase.HELD
        hard = float(np.linalg.norm(press.force)) >= press.settings.force_min
        # Two samples are always alike enough; a quarter of the window says something.
        return PressPhase.STILL if hard and press.still >= 0.25 else PressPhase.PRESSING

    def _watch(self, sample: Sample, tare: Tare | None) -> None:
        """Take a sample of the time before the first poke, with the tare at it."""
        self._times_s = (sample.host_s if self._times_s is None else self._times_s[0]), sample.host_s
        self._samples += 1
        if tare is None or sample.saturated:
            return
        self._strongest = max(self._strongest, _force(sample, tare))
        responses = self.responses[self._candidates]
        limit = answer_limit(self._thresholds, self._tares.noise)[self._candidates]
        # What comes first counts: a soft touch that rests is tared away, and its end goes the other way.
        answered, fell = responses > limit, responses < -limit
        self._answered |= answered & ~self._fell
        self._fell |= fell & ~self._answered

    def _pose_now(self, sample: Sample, link_from_sensor: FloatArray | None, name: str) -> ArmPose:
        """Return the arm's pose; the same object while the arm stands."""
        before = self._arm_pose
        angles = None if self._joints is None or sample.angles is None else sample.angles.take(self._joints)
        if before is not None and before.link_from_sensor is link_from_sensor and before.name == name:
            known = before.angles
            if known is angles or (known is not None and angles is not None and known.tolist() == angles.tolist()):
                return before
        return ArmPose(link_from_sensor, name, angles)

    def _hole(self, sample: Sample) -> float:
        """Return the length of a hole before this sample, else 0; keep the period."""
        if self._last is None:
            return 0.0
        step = sample.host_s - self._last.host_s
        known = self._period_s
        if step > 0:
            self._spacings.append(step)  # a hole too: a device that became slower is one hole after the other
            if len(self._spacings) >= 3 and self._press is None:
                self._period_s = median(self._spacings)
        # Time that stands or goes back parts samples, too.
        return abs(step) if known > 0 and not 0 < step <= GAP_PERIODS * known else 0.0

    def _idle(self, sample: Sample, pose: ArmPose, gap_s: float) -> list[Outcome]:
        outcomes: list[Outcome] = []
        if gap_s > 0:
            # A quiet window is made of successive samples.
            self._tares.interrupt()
        if self._tare_pose is not None and self._turned(self._tare_pose, pose):
            outcomes += self._settle(None)
            self._drop_tare(sample.host_s)
        if sample.saturated:
            self._tares.interrupt()
            return outcomes
        tare = self._tares.tare
        if tare is not None and _force(sample, tare) >= self._thresholds.touch_force:
            self._touch(sample, pose)
            return outcomes
        if tare is None and self._leaning(sample):
            self._tares.interrupt()
            return outcomes
        new = self._tares.feed(sample, self._period_s)
        if new is not None:
            self._tare_pose = pose
            outcomes += self._settle(new)
        return outcomes

    def _touch(self, sample: Sample, pose: ArmPose) -> None:
        before = self._tares.before(sample.host_s)
        assert before is not None
        self._tares.interrupt()
        # With the pose of the tare: an arm that turned since then turned under the poke.
        self._press = Press(self._thresholds, before, sample, self._tare_pose or pose, self._period_s)
        self._press.add(sample, pose)

    def _pressing(self, press: Press, sample: Sample, pose: ArmPose, gap_s: float) -> list[Outcome]:
        if gap_s > 0:
            press.lose(gap_s)
        moved = turned(press.pose, pose)
        press.moved = max(press.moved, moved)
        if self._beyond_tolerance(press.pose, pose, moved):
            outcomes = [*self._end(press), *self._settle(None)]
            self._drop_tare(sample.host_s)
            return outcomes
        if not sample.saturated and _force(sample, press.tare) < press.settings.release_force:
            outcomes = self._end(press)
            # The sample that shows the release is the first of the quiet time after it.
            self._tares.feed(sample, self._period_s)
            return outcomes
        press.add(sample, pose)
        if sample.host_s - press.start_s > TARE_AGE_MAX_S and press.steady:
            return self._give_up(press, sample, sample.host_s - press.tare.end_s, TARE_AGE_MAX_S)
        if not self._rest_seen and press.steady and self._lifted(press, sample):
            outcomes = self._give_up(press, sample, 0.0, self._thresholds.quiet_s)
            self._tares.resting = None
            # What was still just now is the quiet that was wanted.
            for item, its_pose in press.latest:
                outcomes += self._idle(item, its_pose, 0.0)
            return outcomes
        return []

    def _lifted(self, press: Press, sample: Sample) -> bool:
        """Return whether skin lies below its baseline and none above: what was tared away has left."""
        response = (self._scene.skin.polarity * (sample.skin - press.tare.skin))[self._candidates]
        limit = answer_limit(self._thresholds, self._tares.noise)[self._candidates]
        return bool((response < -limit).any()) and not (response > limit).any()

    def _give_up(self, press: Press, sample: Sample, value: float, limit: float) -> list[Outcome]:
        """End a press whose tare is not to be believed: too old, or no quiet went into it."""
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
        )
        outcomes = [*self._settle(None), rejection]
        self._drop_tare(sample.host_s)
        return outcomes

    def _end(self, press: Press) -> list[Outcome]:
        self._press = None
        self._pokes += 1
        poke = finish(self._pokes, press, self._scene, self._candidates, self._tares.noise, self._period_s)
        self._pending.append(poke)
        self._rest_seen = self._rest_seen or len(poke.channels) > 0
        changed = self._health.poke(press.end_s, poke.channels, poke.responses)
        outcomes = self._rejudge() if changed and self._unused is None else []
        return [*outcomes, self._judge(poke, None, final=False)]

    def _settle(self, after: Tare | None) -> list[Outcome]:
        """Make the pokes that wait final, with the tare after them or without one."""
        waiting, self._pending = self._pending, []
        return [self._judge(poke, after, final=True) for poke in waiting]

    def _expire(self, host_s: float) -> list[Outcome]:
        """Make final what waited in vain, so that the list of waiting pokes stays short."""
        outcomes: list[Outcome] = []
        while self._pending and host_s - self._pending[0].end_s > TARE_AGE_MAX_S:
            outcomes.append(self._judge(self._pending.pop(0), None, final=True))
        return outcomes

    def _judge(self, poke: FinishedPress, after: Tare | None, *, final: bool) -> Outcome:
        outcome = judge(poke, self._scene, after, final, self._left_out())
        # A first judgement is not kept: the final one follows.
        if final and _is_crowded(outcome):
            self._doubts[poke.number] = Doubt(poke, after), outcome
        return outcome

    def _rejudge(self) -> list[Outcome]:
        """Judge again what dead channels may have spoilt; return what comes out differently than before."""
        outcomes: list[Outcome] = []
        for number, (doubt, before) in sorted(self._doubts.items()):
            outcome = judge(doubt.poke, self._scene, doubt.after, True, self._left_out())
            if _is_crowded(outcome) != _is_crowded(before):
                self._doubts[number] = doubt, outcome
                outcomes.append(outcome)
        return outcomes

    def _left_out(self) -> Set[int]:
        return self._health.dead.keys() if self._unused is None else self._unused

    def _turned(self, before: ArmPose, now: ArmPose) -> bool:
        return self._scene.arm is not None and self._beyond_tolerance(before, now, turned(before, now))

    def _beyond_tolerance(self, before: ArmPose, now: ArmPose, angle: float) -> bool:
        if self._scene.arm is None:
            return False
        became_known = (before.link_from_sensor is None) != (now.link_from_sensor is None)
        return became_known or angle > self._scene.arm.tolerance

    def _drop_tare(self, host_s: float) -> None:
        self._tares.drop()
        self._tare_pose = None
        self._untared_since = host_s
        self._answer = None

    def _leaning(self, sample: Sample) -> bool:
        """Return whether the skin answers against its last known rest: something still presses."""
        resting = self._tares.resting
        if resting is None or sample.host_s - self._untared_since > TARE_AGE_MAX_S:
            return False
        return len(self._answering(self._scene.skin.polarity * (sample.skin - resting))) > 0

    def _answering(self, responses: FloatArray) -> IntArray:
        """Return the channels in use whose response, (channels,), is above their limit; NaN is not."""
        above = (responses > answer_limit(self._thresholds, self._tares.noise))[self._candidates]
        unused = self._left_out()
        return np.array([channel for channel in self._candidates[above].tolist() if channel not in unused], dtype=np.int64)


def _is_crowded(outcome: Outcome) -> bool:
    return isinstance(outcome, Rejection) and outcome.reason in _CROWDED


def _force(sample: Sample, tare: Tare) -> float:
    return length_of(sample.wrench[:3] - tare.wrench[:3])

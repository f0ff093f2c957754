"""Detect pokes by a tool without a force sensor: from the skin's answers and the rest of the tip.

A press begins when a taxel answers, and ends when none answers at `RELEASE_SHARE` of its limit, or when the tip has left by
`TIP_LEFT_M`. In its still window the tip moves least. The poke is then written as a unit force along the push,
through the tip, in the frame of the tip: all methods use points as they use force axes (docs/decisions/pose-rows.md). The push
is the last way of the tip before it.

At a landmark no taxel answers. There the tip turns back: it comes, rests for `still_s`, and leaves the way that it came. A
pause above the skin is no touch, since the tip goes on where the tool points.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from skincal.contacts.detector import ContactDetector
from skincal.contacts.gates import answer_limit
from skincal.contacts.outcome import RAW_UNIT, Outcome, PressPhase, Reason, Rejection
from skincal.contacts.press import ArmPose, Press
from skincal.contacts.tare import TARE_AGE_MAX_S, Tare, TareKeeper
from skincal.contacts.taxel_answers import TaxelAnswers
from skincal.geometry import FloatArray, IntArray, length_of
from skincal.model.readings import Sample
from skincal.model.scene import ContactSettings, Scene

RELEASE_SHARE = 0.6
"""Share of a taxel's limit below which it no longer answers: noise at the limit cannot end a press."""
TIP_LEFT_M = 0.005
"""m. A tip this far from its rest no longer presses: foam answers for some time after it left."""
APPROACH_M = 0.005
"""m, length of the way before the rest that gives the push."""
APPROACH_MIN_M = 0.001
"""m. A shorter way gives no direction: then the push is along the tool, from its frame's origin to the tip."""
HISTORY_S = 3.0
"""s of places of the tip that are all kept. Of those before only steps of `APPROACH_MIN_M` are: they give the way to a place
where the tip then rests for any time."""
OLDER_STEPS_MAX = 64
"""Such steps, at most."""
REST_RADIUS_M = 0.00075
"""m, largest distance of a resting tip from the begin of its rest: a hand trembles by less."""
TURNED_BACK_MAX_COSINE = -0.7
"""Cosine between the ways to and from a rest, at most, of a touch."""
POINTING_MIN_COSINE = 0.3
"""Cosine between the tool and the way back from a touch, less than minus this: from a pause above a part the tip goes on."""
POINTING_MIN_LENGTH_M = 0.02
"""m. A tip nearer to the origin of the tool's frame does not tell where the tool points."""
PARKED_S = 1.0
"""s of rest before the first answer of a taxel that show a parked tip: something else presses."""
QUIET_SKIN_MAX_SHARE = 0.3
"""Largest change of a taxel in a quiet window, as a share of its limit."""


class _Seen(NamedTuple):
    time_s: float
    place: FloatArray
    """(3,) float, metres, link: of the tip's centre."""
    pointing: FloatArray | None
    """(3,) float, unit, link: from the tool's frame to the tip; `None` if the poses are those of the tip."""
    response: float
    """Raw units, of the taxel nearest to its limit; NaN before a tare."""
    needed: float
    """Raw units, its limit."""


class Touch(NamedTuple):
    """A touch that no taxel answered."""

    start_s: float
    end_s: float
    place: FloatArray
    push: FloatArray
    response: float
    needed: float


class SkinRestKeeper(TareKeeper):
    """Quiet windows by the skin alone."""

    def __init__(self, scene: Scene, answers: TaxelAnswers, candidates: IntArray) -> None:
        super().__init__(scene.contacts, scene.skin.frame_width)
        self._settings, self._answers, self._candidates = scene.contacts, answers, candidates

    def is_quiet_run(self, run: Sequence[Sample], wrench: FloatArray, quiet: int) -> bool:
        """Whether no taxel changes in the first `quiet` samples of a run and after them."""
        del wrench
        skin, half = np.array([sample.skin for sample in run]), quiet // 2
        limit = QUIET_SKIN_MAX_SHARE * answer_limit(self._settings, self._answers.noise(self.noise))
        first, second, after = (np.median(part, axis=0) for part in (skin[:half], skin[half:quiet], skin[quiet:]))
        change = np.maximum(self._answers.sizes(second - first), self._answers.sizes(after - second))
        return not bool((change > limit)[self._candidates].any())  # NaN is not above


class TouchPress(Press):
    """A press of a tool without a sensor: `approach` are the places of the tip before it, metres, link."""

    def __init__(
        self, settings: ContactSettings, tare: Tare, start: Sample, pose: ArmPose, period_s: float, approach: FloatArray
    ) -> None:
        super().__init__(settings, tare, start, pose, period_s)
        self._approach = approach

    def add(self, sample: Sample, pose: ArmPose) -> None:
        """Take one sample of the press."""
        self.end_s = sample.host_s
        if pose.link_from_sensor is None:
            self.unplaced += 1
            self._window.clear()
            self.still = 0.0
            return
        self._append(sample, pose)
        places = np.array([each.link_from_sensor[:3, 3] for _, each in self._window if each.link_from_sensor is not None])
        off = np.linalg.norm(places - places[-1], axis=1)[::-1] > self.settings.slide_max
        self.still = (int(off.argmax()) if off.any() else len(off)) / self._length
        if len(self._window) == self._length:
            self._rank_places(places)

    def _rank_places(self, places: FloatArray) -> None:
        """Keep the window that ends now if its tip moves less than in the best so far."""
        slide = tip_slide(places)
        share = slide / self.settings.slide_max
        rank = (0.0, max(share, 1.0), 0.0, share)
        if rank >= self._best_rank:
            return
        middle = self._middle_pose.link_from_sensor
        assert middle is not None
        place, link_from_sensor = places.mean(axis=0), middle.copy()
        push = push_direction(self._approach, place, link_from_sensor)
        link_from_sensor[:3, 3] = place
        wrench = np.concatenate([link_from_sensor[:3, :3].T @ push, np.zeros(3)])
        self._keep_window(rank, wrench, link_from_sensor, spread=0.0, slide=slide, tip=place)

    def has_left(self, place: FloatArray) -> bool:
        """Whether the tip at `place` (3,), metres, is away from the still window."""
        return self.best is not None and self.best.tip is not None and length_of(place - self.best.tip) > TIP_LEFT_M


def tip_slide(places: FloatArray) -> float:
    """Compute how far the tip moves in a window, metres, from its places (n, 3), n >= 3, in any shape of its way.

    It is 1.5 times the largest distance between the means of the thirds: the length of a straight way, with little noise.
    """
    thirds = np.array([part.mean(axis=0) for part in np.array_split(places, 3)])
    apart = np.linalg.norm(thirds[:, None] - thirds[None], axis=2)
    return 1.5 * float(apart.max())


def push_direction(approach: FloatArray, place: FloatArray, link_from_sensor: FloatArray) -> FloatArray:
    """Find the direction (3,) of the tip's way to a place: from the last point that was `APPROACH_M` away.

    Parameters
    ----------
    approach : (n, 3) float, metres: places before, the newest last
    link_from_sensor : (4, 4) float: its z axis is the push of a tip that hardly moved
    """
    distances = np.linalg.norm(approach - place, axis=1)
    far = np.flatnonzero(distances >= APPROACH_M)
    row = int(far[-1]) if len(far) else int(distances.argmax()) if len(distances) else -1
    if row < 0 or distances[row] < APPROACH_MIN_M:
        return link_from_sensor[:3, 2]
    return (place - approach[row]) / distances[row]


class _Rest:
    """A rest of the tip that goes on: its sums, since it may last for hours."""

    def __init__(self, first: _Seen) -> None:
        self.first, self.last, self.strongest = first, first, first
        self._count, self._sum = 0, np.zeros(3)
        self.add(first)

    def add(self, seen: _Seen) -> None:
        self._count, self._sum = self._count + 1, self._sum + seen.place
        self.last = seen
        if _share_of(seen) > _share_of(self.strongest):
            self.strongest = seen

    @property
    def seconds(self) -> float:
        return self.last.time_s - self.first.time_s

    @property
    def place(self) -> FloatArray:
        """(3,) float, metres, link: mean of the places."""
        return self._sum / self._count


def _share_of(seen: _Seen) -> float:
    return seen.response / seen.needed if math.isfinite(seen.response) else -math.inf


class RestWatch:
    """Finds rests of the tip from which it goes back the way that it came."""

    def __init__(self, still_s: float) -> None:
        self.still_s = still_s
        self._recent: deque[_Seen] = deque()
        self._older: deque[_Seen] = deque(maxlen=OLDER_STEPS_MAX)
        self._rest: _Rest | None = None
        self._left: Touch | None = None

    def places_before(self, time_s: float = math.inf) -> FloatArray:
        """List the places (n, 3) of the tip before a time, metres, link, the newest last."""
        seen = [each.place for of in (self._older, self._recent) for each in of if each.time_s < time_s]
        return np.array(seen, dtype=np.float64).reshape(-1, 3)

    @property
    def began_s(self) -> float:
        """Host's monotonic clock, s: begin of the present rest; infinite without one."""
        return math.inf if self._rest is None else self._rest.first.time_s

    def feed(self, seen: _Seen) -> Touch | None:
        """Follow the tip; give the touch that it has just left."""
        self._recent.append(seen)
        while seen.time_s - self._recent[0].time_s > HISTORY_S and len(self._recent) > 1:
            old = self._recent.popleft()
            if not self._older or length_of(old.place - self._older[-1].place) >= APPROACH_MIN_M:
                self._older.append(old)
        rest = self._rest
        if rest is None or length_of(seen.place - rest.first.place) > REST_RADIUS_M:
            if rest is not None and rest.seconds >= self.still_s:
                self._left = self._touch(rest)
            self._rest = _Rest(seen)
        else:
            rest.add(seen)
        left = self._left
        if left is None or length_of(seen.place - left.place) < TIP_LEFT_M:
            return None
        self._left = None
        away = (seen.place - left.place) / length_of(seen.place - left.place)
        if seen.pointing is not None and float(away @ seen.pointing) > -POINTING_MIN_COSINE:
            return None
        return left if float(away @ left.push) <= TURNED_BACK_MAX_COSINE else None

    def _touch(self, rest: _Rest) -> Touch | None:
        place, before = rest.place, self.places_before(rest.first.time_s)
        distances = np.linalg.norm(before - place, axis=1)
        far = np.flatnonzero(distances >= APPROACH_M)
        if not len(far):
            return None
        push = (place - before[int(far[-1])]) / distances[far[-1]]
        most = rest.strongest
        return Touch(rest.first.time_s, rest.last.time_s, place, push, most.response, most.needed)

    def forget(self) -> None:
        """Forget the way of the tip after a break."""
        self._recent.clear()
        self._older.clear()
        self._rest = self._left = None


class TouchDetector(ContactDetector):
    """Detector of the pokes of a session without a force sensor; parameters as of `ContactDetector`."""

    finds_touches_at_rest = True

    def _make_tares(self, scene: Scene) -> TareKeeper:
        self._rests = RestWatch(scene.contacts.still_s)
        self._press_ended_s = -math.inf
        self._is_recovering = False
        tip = None if scene.tool is None else scene.tool.tip
        length = 0.0 if tip is None else length_of(tip)
        self._pointing = None if tip is None or length < POINTING_MIN_LENGTH_M else tip / length
        return SkinRestKeeper(scene, self._answers, self._candidates)

    def use_thresholds(self, thresholds: ContactSettings) -> None:
        """Use these thresholds for pokes that begin from now on. Earlier pokes keep theirs."""
        super().use_thresholds(thresholds)
        self._rests.still_s = thresholds.still_s

    def reset(self, host_s: float | None = None, *, is_loss: bool = True) -> list[Outcome]:
        """Start again after a break, as `ContactDetector.reset`."""
        self._rests.forget()
        self._is_recovering = False
        return super().reset(host_s, is_loss=is_loss)

    @property
    def phase(self) -> PressPhase:
        """State of the detector: waiting, or the progress of a poke."""
        press = self._press
        if press is None or press.may_release:
            return super().phase
        return PressPhase.STILL if press.still >= 0.25 else PressPhase.PRESSING

    def _feed_idle(self, sample: Sample, pose: ArmPose, gap_s: float) -> list[Outcome]:
        outcomes: list[Outcome] = []
        if gap_s > 0:
            self._tares.interrupt()
        share = self._strongest_share(sample)
        outcomes += self._find_touch(sample, pose, share)
        tare = self._tares.tare
        if share < RELEASE_SHARE or sample.host_s - self._press_ended_s > TARE_AGE_MAX_S:
            self._is_recovering = False
        if tare is not None and share >= 1.0 and not self._is_recovering:
            before = self._tares.before(sample.host_s) or tare
            self._tares.interrupt()
            approach = self._rests.places_before()
            self._press = TouchPress(self._thresholds, before, sample, pose, self._period_s, approach)
            self._press.add(sample, pose)
            return outcomes
        if self._is_recovering:
            self._tares.interrupt()
            return outcomes
        return outcomes + self._feed_rest(sample, pose)

    def _feed_press(self, press: Press, sample: Sample, pose: ArmPose, gap_s: float) -> list[Outcome]:
        if gap_s > 0:
            press.note_gap(gap_s)
        share = self._strongest_share(sample)
        self._find_touch(sample, pose, share)
        place = None if pose.link_from_sensor is None else pose.link_from_sensor[:3, 3]
        has_left = isinstance(press, TouchPress) and place is not None and press.has_left(place)
        if share < RELEASE_SHARE or has_left:
            self._press_ended_s, self._is_recovering = sample.host_s, share >= RELEASE_SHARE
            return self._end(press)
        return self._feed_held(press, sample, pose)

    def _feed_held(self, press: Press, sample: Sample, pose: ArmPose) -> list[Outcome]:
        """Process a sample of a press that goes on; one that is too long for its tare ends, with its stillest window so far."""
        press.add(sample, pose)
        if sample.host_s - press.tare.end_s <= TARE_AGE_MAX_S or not press.is_steady:
            return []
        if press.best is None or self._rests.began_s < press.start_s - PARKED_S:
            return self._reject_untared(press, sample, sample.host_s - press.tare.end_s, TARE_AGE_MAX_S)
        self._press_ended_s, self._is_recovering = sample.host_s, True
        return self._end(press)

    def _strongest_share(self, sample: Sample) -> float:
        """Compute the strongest answer of a taxel over its limit; 0 before a tare."""
        response, needed = self._nearest_answer(sample)
        return max(0.0, response / needed) if math.isfinite(response) else 0.0

    def _nearest_answer(self, sample: Sample) -> tuple[float, float]:
        """Find the response of the taxel nearest to its limit, and that limit, raw units; NaN before a tare."""
        tare, ignored = self._tares.tare, self._ignored_now()
        used: IntArray = np.array([each for each in self._candidates.tolist() if each not in ignored], np.int64)
        if tare is None or not len(used):
            return math.nan, math.nan
        limit = answer_limit(self._thresholds, self._noise)[used]
        response = self._answers.responses(sample.skin - self._drift.rest_at(tare, sample.host_s))[used]
        share = np.where(np.isfinite(response), response / limit, -np.inf)
        row = int(share.argmax())
        return float(response[row]), float(limit[row])

    def _find_touch(self, sample: Sample, pose: ArmPose, share: float) -> list[Outcome]:
        """Follow the tip; give the poke that no taxel answered, if it has just ended."""
        if pose.link_from_sensor is None or sample.has_late_tool:
            return []
        response, needed = self._nearest_answer(sample)
        pointing = None if self._pointing is None else pose.link_from_sensor[:3, :3] @ self._pointing
        touch = self._rests.feed(_Seen(sample.host_s, pose.link_from_sensor[:3, 3], pointing, response, needed))
        if share >= 1.0:
            self._press_ended_s = sample.host_s
        if touch is None or self._press is not None or touch.start_s <= self._press_ended_s:
            return []
        self._pokes += 1
        link_from_sensor = pose.link_from_sensor.copy()
        link_from_sensor[:3, 3] = touch.place
        known = math.isfinite(touch.response)
        rejection = Rejection(
            poke=self._pokes,
            start_s=touch.start_s,
            end_s=touch.end_s,
            reason=Reason.NO_TAXEL,
            value=touch.response if known else 0.0,
            limit=touch.needed if known else self._thresholds.response_min,
            unit=RAW_UNIT,
            channels=np.empty(0, dtype=np.int64),
            final=True,
            force=link_from_sensor[:3, :3].T @ touch.push,
            moment=np.zeros(3),
            link_from_sensor=link_from_sensor,
            pose=pose.name,
        )
        return [*self._finalize_pending(None), rejection]

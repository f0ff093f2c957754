"""Touches of one point by a tool whose poses are streamed: the fixed-point test while the poses come.

Each touch is the pose at the end of half a second of rest, in the numbers of the device: only they can be read in another form.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from skincal.geometry import FloatArray
from skincal.model.errors import InputError, plural
from skincal.model.pose_form import PoseForm, SentPose
from skincal.rig.pivot import MIN_TOUCHES, PivotResult, judge_touches

REST_S = 0.5
"""s of rest before a touch is taken."""
REST_MAX_M = 0.0005
"""m, largest motion of the streamed frame along an axis in that time: a robot at rest is a tenth of it, a hand is above."""
REST_MAX_TURN = 0.01
"""Largest change of an entry of the rotation matrix in that time: 0.6 degrees."""
MIN_READINGS_AT_REST = 3
POSITION_COLUMNS = (3, 7, 11)
"""Of the upper rows of a 4 x 4 pose."""


@dataclass(slots=True)
class RestWindow:
    """The poses of the last `REST_S` of a stream, and the one before them."""

    _poses: deque[tuple[float, FloatArray]] = field(default_factory=deque[tuple[float, FloatArray]])

    def add(self, now_s: float, poses: Iterable[FloatArray]) -> None:
        """Add poses (12,) float, upper rows of 4 x 4, metres, that came until `now_s`; those that are none are left out."""
        self._poses.extend((now_s, pose) for pose in poses if np.isfinite(pose).all())
        while len(self._poses) > 1 and now_s - self._poses[1][0] >= REST_S:
            self._poses.popleft()

    def require_rest(self, now_s: float) -> None:
        """Raise `InputError` if the tool moved in the last `REST_S` before `now_s`, or too few poses came in this time."""
        count = sum(now_s - at_s < REST_S for at_s, _ in self._poses)
        if count < MIN_READINGS_AT_REST:
            raise InputError(
                f"{plural(count, 'pose')} came in the last {REST_S:g} s; expected {MIN_READINGS_AT_REST} or more: check the "
                "stream."
            )
        if now_s - self._poses[0][0] < REST_S:
            raise InputError(f"The stream has just begun; hold the tool still for {REST_S:g} s, then take the touch.")
        spans = np.ptp(np.array([pose for _, pose in self._poses]), axis=0)
        place = list(POSITION_COLUMNS)
        moved, turned = float(spans[place].max()), float(np.delete(spans, place).max())
        if moved > REST_MAX_M or turned > REST_MAX_TURN:
            words = f"moved by {moved * 1e3:.1f} mm" if moved > REST_MAX_M else f"turned by {np.degrees(turned):.1f}°"
            raise InputError(f"The tool {words} in the last {REST_S:g} s; hold it still at the point, then take the touch.")


@dataclass(frozen=True, slots=True)
class TouchSeries:
    """Touches so far, all with the same number of values; immutable."""

    touches: tuple[SentPose, ...] = ()

    def added(self, touch: SentPose) -> TouchSeries:
        """Add a touch; touches with another number of values, as of another form, are dropped."""
        alike = tuple(each for each in self.touches if len(each.numbers) == len(touch.numbers))
        return TouchSeries((*alike, touch))

    def removed(self, rows: Sequence[int]) -> TouchSeries:
        """Leave out the touches in these rows."""
        return TouchSeries(tuple(each for row, each in enumerate(self.touches) if row not in rows))

    @property
    def missing(self) -> int:
        """Touches that are needed before the test says anything."""
        return max(0, MIN_TOUCHES - len(self.touches))

    def judge(self, form: PoseForm | None) -> PivotResult | None:
        """Judge the touches, read in `form`; `None` while some are missing. Without a form all are compared.

        Raises InputError: the numbers are no poses in this form.
        """
        if self.missing:
            return None
        values = np.array([each.numbers for each in self.touches])
        where = [f"touch {number}" for number in range(1, len(values) + 1)]
        return judge_touches(values, self.touches[-1].metres_per_unit, where, form)

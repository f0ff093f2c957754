"""What pokes at landmarks tell of the rig, and where the taxels lie with and without its correction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from skincal.estimate.frame_doctor import FrameDiagnosis
from skincal.estimate.result import Method
from skincal.estimate.rig_fit import RigAnswer
from skincal.readings import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Review:
    """The answer, as of one moment of a session."""

    frame: FrameDiagnosis | None
    """What the sensor's frame looks like; None from too few pokes."""
    rig: RigAnswer
    channels: IntArray
    """(n,) of the taxels, ascending."""
    before: Mapping[Method, FloatArray]
    """For each method (n, 3) float, metres, link frame: the taxels as the rig tells; NaN where not known."""
    after: Mapping[Method, FloatArray]
    """The same under the correction that was found, whether it is in use or not; empty where there is none."""

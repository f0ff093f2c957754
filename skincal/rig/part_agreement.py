"""Agreement of the touches of landmarks with the pose of a part that follows from them, for rigs without a force sensor.

Each landmark is predicted from all other touches (`part_pose`). So a landmark with a wrong name or place, a wrong mesh and a
wrong tip show, and the pose cannot hide its own errors. All touches together must agree, too.
"""

from __future__ import annotations

from skincal.rig.correction_fit import MIN_LANDMARKS, LandmarkAgreement
from skincal.rig.part_pose import PartPose


def agreement_with_part(pose: PartPose | None) -> LandmarkAgreement | None:
    """Compare the touches of landmarks with their prediction; `None` with too few, or while the pose is unknown."""
    if pose is None or not pose.is_known or pose.landmark_places < MIN_LANDMARKS:
        return None
    return LandmarkAgreement(pose.landmarks, max(pose.held_out_ratio, pose.ratio), False)

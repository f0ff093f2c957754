"""Agreement of the touches of landmarks with the pose of a part that follows from them, where a tool's tip places the pokes.

Each landmark is predicted from all other touches (`part_pose`). So a landmark with a wrong name or place, a wrong mesh and a
wrong tip show, and the pose cannot hide its own errors. All touches together must agree, too. Touches of a robot that drove to
the landmarks by a pose of the part agree with each other under any such pose.
"""

from __future__ import annotations

from skincal.rig.correction import UsedCorrection
from skincal.rig.correction_fit import MIN_LANDMARKS, LandmarkAgreement, RigAnswer, landmark_agreement
from skincal.rig.part_pose import PartPose
from skincal.rig.tip_frame import TipFrame


def agreement_with_part(pose: PartPose | None, driven: int = 0) -> LandmarkAgreement | None:
    """Compare the touches of landmarks with their prediction; `None` with too few, or while the pose is unknown.

    `driven` is as in `agreement_at_landmarks`.
    """
    if pose is None or not pose.is_known or pose.landmark_places < MIN_LANDMARKS:
        return None
    ratio = max(pose.held_out_ratio, pose.ratio)
    return LandmarkAgreement(pose.landmarks, ratio, corrected=False, by_part=True, driven=driven)


def agreement_at_landmarks(
    rig: RigAnswer | None, used: UsedCorrection | None, part: PartPose | None, tip: TipFrame | None, driven: int = 0
) -> LandmarkAgreement | None:
    """Compare landmark pokes with their prediction, in any rig; `None` with too few.

    Where a tip places the pokes, the pose of the part follows from these landmarks: the sensor's errors say nothing about them.

    Parameters
    ----------
    rig, used : as of `landmark_agreement`
    part : pose of the part that is found from the touches; `None` in other rigs
    tip : frame of the tip; `None` without one
    driven : number of the touches in `part` at landmarks that a robot drove to by a pose of the part
    """
    if used is None and part is not None and tip is not None and tip.places_pokes:
        return agreement_with_part(part, driven)
    return landmark_agreement(rig, used)

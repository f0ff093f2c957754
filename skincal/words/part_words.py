"""Sentences on the pose of a part in the base of a tool's poses, and on the tip that pokes show."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from skincal.model.tool_rig import ToolSpec
from skincal.rig.correction_fit import MIN_LANDMARKS
from skincal.rig.mesh_distance import MeshDistance
from skincal.rig.part_pose import MIN_TOUCHES, MISFIT_MIN_RATIO, PartPose, PartPoseState
from skincal.rig.part_scale import DrawnThing, WrongScale
from skincal.rig.part_touches import OpenMotion
from skincal.rig.tip_frame import TIP_FRAME_MIN_POKES, TipFrame, TipState
from skincal.rig.tool_tip import TIP_SPREAD_MAX_M, ToolTip
from skincal.words.units import count, degrees, direction, millimetres, point_mm

OPEN_ABOVE_M = 0.05
"""m. A larger sd of a motion only says that nothing was measured."""
MOST_OPEN_MOTIONS_NAMED = 2
RIVAL_DOUBTED_ABOVE_RATIO = 1.5
"""Misses over expected ones of a pose, above which another one fits as well only because none fits."""
MISFIT_ADVICE = (
    "The cause may be the tip, a landmark with another name or place, or a part that moved. Make the fixed-point test (Session "
    "menu, or `skincal tool`), and touch more landmarks: with six or more the mistake is named."
)
TIP_SHIFT_NAMED_ABOVE_CHI2 = 12.84
"""An error of the tip that the touches show is named above it: one right tip in 200 (chi-square, three degrees of freedom)."""
ADD_LANDMARK = "The scene has no landmarks: add one, such as a corner or a screw whose place the drawing gives, and touch it."
_WORDS_OF_THING = {
    DrawnThing.LANDMARKS: ("landmarks lie", "too far apart", "too close together"),
    DrawnThing.DRAWING: ("landmarks and mesh are", "too large", "too small"),
    DrawnThing.MESH: ("mesh is", "too large", "too small"),
    DrawnThing.MESH_X: ("mesh is", "too wide along x", "too narrow along x"),
    DrawnThing.MESH_Y: ("mesh is", "too wide along y", "too narrow along y"),
    DrawnThing.MESH_Z: ("mesh is", "too wide along z", "too narrow along z"),
}


def open_motion_words(motion: OpenMotion) -> str:
    """Describe a motion of the part that the touches leave open: `"may lie 4 mm farther along (0.00 0.00 1.00)"`."""
    if motion.is_shift:
        way = f"along ({direction(motion.shift / np.linalg.norm(motion.shift))})"
        return f"may lie anywhere {way}" if motion.sd > OPEN_ABOVE_M else f"may lie {millimetres(motion.sd)} farther {way}"
    angle = float(np.linalg.norm(motion.turn))
    about = f"about ({direction(motion.turn / angle)})"
    if motion.sd > OPEN_ABOVE_M or angle > math.pi / 4:
        return f"may be turned anyhow {about}"
    return f"may be turned by {degrees(angle, 1)} {about}, {millimetres(motion.sd)} at its ends"


def _open_words(pose: PartPose) -> str:
    if pose.ratio > MISFIT_MIN_RATIO:
        return _misfit_words(pose)
    named = [open_motion_words(motion) for motion in pose.open_motions[:MOST_OPEN_MOTIONS_NAMED]]
    landmark = "one more landmark, from another side" if pose.landmark_places else "one landmark"
    return f"The part {', and '.join(named)}: touch {landmark}." if named else ""


def _misfit_words(pose: PartPose) -> str:
    """Describe touches that fit no pose well: one landmark more would not decide between poses, but show the mistake."""
    return f"The touches miss by {pose.ratio:.1f} times the expected error. {MISFIT_ADVICE}"


def part_pose_sentence(pose: PartPose, landmark: str = "") -> str:
    """Describe the pose of the part in the base, and the pokes that it lacks.

    Parameters
    ----------
    landmark : name of the landmark of `pose.worst_landmark`
    """
    unknown = "Part: its pose in the base is not known yet, so positions are in the base."
    match pose.state:
        case PartPoseState.FEW_TOUCHES:
            return f"{unknown} Press {MIN_TOUCHES} landmarks or more, or places on all sides of the part."
        case PartPoseState.OPEN:
            return f"{unknown} {_open_words(pose)}"
        case PartPoseState.AMBIGUOUS:
            return f"{unknown} {_rival_words(pose)}"
        case PartPoseState.DISAGREES:
            worst = f" Landmark {landmark} misses most, by {millimetres(pose.worst_miss)}." if landmark else ""
            return (
                f"{unknown} No pose fits: the touches miss by {pose.ratio:.0f} times the expected error.{worst} "
                "Check the names of the landmarks, the mesh and the tip, and make the fixed-point test (Session menu, or "
                "`skincal tool`)."
            )
        case PartPoseState.KNOWN:
            seen = (
                (pose.landmarks, "landmark poke", "landmark pokes"),
                (pose.taxels, "poke at planned taxels", "pokes at planned taxels"),
                (pose.points, "point on the mesh", "points on the mesh"),
            )
            of = ", ".join(count(number, one, many) for number, one, many in seen if number)
            known = f"Part: its pose in the base is known to {millimetres(pose.sd)} everywhere on it, from {of}."
            return " ".join(filter(None, (known, _open_words(pose), _few_landmarks_words(pose.landmark_places))))


def _few_landmarks_words(touched: int) -> str:
    """Name the limit of too few landmarks; empty with enough, or none."""
    if not 0 < touched < MIN_LANDMARKS:
        return ""
    return (
        f"{count(touched, 'landmark gives', 'landmarks give')} the pose and cannot check it: a landmark with a wrong place may "
        f"fit as well. Touch {MIN_LANDMARKS} or more, with the tool turned another way at each."
    )


def driven_pose_sentence(driven: int) -> str:
    """Warn of a pose of the part from landmarks that a robot drove to by another pose of it."""
    return (
        f"Part: a robot drove to {count(driven, 'landmark touch', 'landmark touches')} by a pose of the part, so its pose here "
        "is as wrong as that one, and no error contains that. Guide the tip to the landmarks by hand."
    )


def tip_shift_sentence(part: PartPose, tool: ToolSpec) -> str:
    """Warn of a tip that the touches show elsewhere than `tip_mm`; empty if they agree, or no tip is given."""
    if tool.tip is None or not part.is_known or part.tip_shift_chi2 <= TIP_SHIFT_NAMED_ABOVE_CHI2:
        return ""
    shift = tool.tool_from_sensor[:3, :3] @ part.tip_shift
    return (
        f"The touches show the tip ({point_mm(shift)}) mm from tip_mm, in the tool's frame, and the taxels are placed by it. "
        "Make the fixed-point test, and correct tip_mm."
    )


def _rival_words(pose: PartPose) -> str:
    assert pose.rival is not None
    if pose.ratio > RIVAL_DOUBTED_ABOVE_RATIO:
        return _misfit_words(pose)
    between = pose.rival @ pose.base_from_link
    angle = math.acos(min(1.0, max(-1.0, (float(np.trace(between[:3, :3])) - 1.0) / 2.0)))
    if angle < math.radians(10.0):
        return f"Another place fits as well, {millimetres(float(np.linalg.norm(between[:3, 3])))} off: touch one landmark."
    return f"The part fits as well turned by {degrees(angle)}: touch one landmark."


def typed_pose_sentence(found: PartPose) -> str:
    """Describe that the touches show another pose of the part than `base_from_link` of the scene."""
    change = found.motion_to(np.eye(4))
    angle = float(np.linalg.norm(change[:3]))
    turn = "" if angle < math.radians(0.5) else f" and turned by {degrees(angle, 1)}"
    return (
        f"The part does not lie where base_from_link of [tool] puts it: by the touches it is moved by "
        f"({point_mm(change[3:])}) mm{turn}. Leave base_from_link out: pokes show the pose."
    )


def _scale_words(thing: DrawnThing, excess: float) -> str:
    who, large, small = _WORDS_OF_THING[thing]
    return f"the {who} {abs(excess):.1%} {large if excess > 0.0 else small}"


def wrong_scale_sentence(found: WrongScale) -> str:
    """Warn of a drawing with another scale than the touched part, and name its likely errors."""
    words = [_scale_words(found.thing, found.excess), *(_scale_words(*other) for other in found.others)]
    counted = (
        count(found.landmarks, "landmark") if found.landmarks else "",
        count(found.points, "place") if found.points else "",
    )
    of = " and ".join(filter(None, counted))
    return (
        f"The drawing of the part seems to have another scale: {', or '.join(words)}. The touches of {of} say "
        f"{1.0 - found.excess:.3f} of the drawn length, known to {found.sd:.3f}. "
        "Measure one length of the part, and correct the scene."
    )


def landmarks_off_mesh_sentence(distance: float) -> str:
    """Warn of landmarks at a `distance` (rms, metres) from the mesh of the scene, negative if most are inside."""
    side = "outside" if distance > 0.0 else "inside"
    return (
        f"The landmarks of the scene lie {millimetres(abs(distance))} {side} its mesh, and the predicted errors contain that. "
        "If they are on the surface of the part, landmarks or mesh have another scale than the part."
    )


def off_mesh_sentence(found: MeshDistance) -> str:
    """Warn of touches that miss the mesh, with the settings to check."""
    side = "outside" if found.height > 0.0 else "inside"
    return (
        f"{found.touches} touches lie {millimetres(found.distance, 0)} {side} the mesh (median), with an expected error of "
        f"{millimetres(found.expected)}. Positions of the free method are wrong by as much, and others may be. Check tip_mm "
        "and tip_radius_mm of [tool], the tool centre point of the robot, then base_from_link and the unit of the mesh."
    )


def tool_rig_sentences(
    tip: TipFrame | None,
    part: PartPose | None,
    typed_error: PartPose | None,
    at_landmarks: Mapping[int, str],
    off_mesh: MeshDistance | None = None,
    wrong_scale: WrongScale | None = None,
) -> tuple[str, ...]:
    """Describe the tip of a tool and the part's pose in the base; `at_landmarks` has the landmark of each poke at one."""
    found = [tool_tip_sentence(tip)] if isinstance(tip, ToolTip) and not tip.is_given_alone else []
    if part is not None:
        found.append(part_pose_sentence(part, at_landmarks.get(part.worst_landmark, "")))
    if part is not None and part.is_known and part.scales.landmarks_off_mesh:
        found.append(landmarks_off_mesh_sentence(part.scales.landmarks_off_mesh))
    if wrong_scale is not None:
        found.append(wrong_scale_sentence(wrong_scale))
    if typed_error is not None:
        found.append(typed_pose_sentence(typed_error))
    if off_mesh is not None:
        found.append(off_mesh_sentence(off_mesh))
    return tuple(found)


def tool_tip_sentence(tip: ToolTip) -> str:
    """Describe the tip of a tool, and whether the force axes meet at it."""
    axes = tip.axes
    match tip.state:
        case TipState.DISAGREES if tip.is_mismatch and axes is not None and tip.known is not None:
            away = millimetres(float(np.linalg.norm(axes.place - tip.known)))
            return (
                f"Tip: the force axes of {axes.pokes} pokes meet at ({point_mm(axes.place)}) mm of the sensor's frame, "
                f"{away} from tip_mm of the scene. The tip is not used. Check that the tool centre point is that of this tool, "
                "flange, and the point that the moments are about."
            )
        case TipState.DISAGREES:
            spread = millimetres(tip.tip_sd)
            return (
                f"Tip: the force axes do not meet at one tip: they scatter by {spread}, more than "
                f"{millimetres(TIP_SPREAD_MAX_M)}. Check flange, and that the wrench has the axes of the sensor and moments "
                "about its origin."
            )
        case TipState.USED if axes is not None and tip.known is None:
            return (
                f"Tip: the force axes of {axes.pokes} pokes meet at ({point_mm(axes.place)}) mm of the sensor's frame, "
                f"known to {millimetres(axes.sd)}. It is used."
            )
        case TipState.USED:
            agrees = f" The force axes of {count(axes.pokes, 'poke')} agree with it" if axes is not None else ""
            if axes is not None and axes.is_open:
                agrees += (
                    f", but do not show it along ({direction(axes.open_direction)}) of the sensor's frame: pushes that lean "
                    "against the tool would"
                )
            return f"Tip: tip_mm of the scene is used.{agrees}{'.' if agrees else ''}"
        case TipState.AMBIGUOUS if axes is not None:
            return (
                f"Tip: the force axes leave it open along ({direction(axes.open_direction)}) of the sensor's frame. "
                "It is not used. Give tip_mm, or lean the pushes against the tool in several directions."
            )
        case _:
            return f"Tip: unknown. The force axes show it from {TIP_FRAME_MIN_POKES} pokes on; or give tip_mm."

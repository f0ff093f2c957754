"""Sentences on mistakes of the scene: how far pokes miss landmarks or taxels, the likely mistake, and its remedy."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from skincal.geometry import FloatArray, rotation_vector
from skincal.rig.frame_check import FrameDiagnosis
from skincal.rig.scene_mistakes import STANDARD_GRAVITY, Mistake, MistakeKind
from skincal.rig.setup_check import SetupDiagnosis
from skincal.words.taxel_words import rig_name
from skincal.words.units import direction, millimetres

MENTION_RIG_ERRORS_ABOVE_MISS_M = 0.005
"""Landmark miss above which a sentence on a right frame names errors of sensor and arm; noise and hand cause 1 to 3 mm."""

MIRROR_REMEDY = (
    "change mirror of every module in the layout file (without that line it is false), and the signs of its x of place_mm and "
    "its angle_deg, if it has them"
)
CORRECT_SENSOR = (
    "correct the sensor's pose in the scene or its origin in the URDF, or press three landmarks and use the correction that is "
    "then offered"
)


def setup_sentences(found: SetupDiagnosis | None) -> tuple[str, ...]:
    """Name the likely mistakes of a scene with their remedies; empty if there is no sign of one."""
    if found is None or not found.mistakes:
        return ()
    first, *others = found.mistakes
    if first.kind is MistakeKind.WRENCH_FRAME:
        return (
            f"{found.pokes} pokes miss the taxels that answer by {millimetres(first.miss, 0)} (median), and it is not known in "
            f"which frame the wrench is: its messages name {first.names[0]}. Settle that first, then other mistakes are looked "
            "for.",
        )
    if first.kind is MistakeKind.TOOL_UNEXPLAINED:
        return (
            f"{found.pokes} pokes miss the taxels that answer by {millimetres(first.miss, 0)} (median), and no known mistake "
            "explains it. Make the fixed-point test (Session menu, or `skincal tool`), then check base_from_link and flange of "
            "[tool], and axes and sign of the wrench.",
        )
    what, remedy = mistake_words(first)
    misses = (
        ""
        if first.is_reaction or (found.of_touches and not first.miss)
        else f" {found.pokes} touches miss landmarks and taxels that answer by {millimetres(found.miss, 0)} (median), and with "
        f"this change by {millimetres(first.miss, 0)}."
        if found.of_touches
        else f" {found.pokes} pokes miss the taxels that answer by {millimetres(found.miss, 0)} (median), and with this change "
        f"by {millimetres(first.miss, 0)}."
    )
    return (
        f"The scene does not fit the pokes: {what}. To mend it, {remedy}.{misses}",
        *(f"Also possible: {what}. Then {remedy}." for what, remedy in map(mistake_words, others)),
    )


_MISTAKE_WORDS: Mapping[MistakeKind, tuple[str, str]] = {
    MistakeKind.FLANGE: ("the sensor is turned by about {degrees:.0f} degrees about its {names[0]} axis", CORRECT_SENSOR),
    MistakeKind.JOINTS_EXCHANGED: (
        "the columns of {names[0]} and {names[1]} are exchanged",
        "exchange them in joints of the scene",
    ),
    MistakeKind.JOINT_UNIT: ("the joint angles are in {names[0]}", "send degrees"),
    MistakeKind.JOINT_SIGN: ("joint {names[0]} turns the other way", "invert it in the joint stream, or its axis in the URDF"),
    MistakeKind.JOINT_ANGLE: (
        "joint {names[0]}, which the scene holds fixed, is at about {degrees:.0f} degrees",
        "correct it in [robot.fixed], or stream it: name it in joints",
    ),
    MistakeKind.OTHER_ARM: (
        "this is the arm on the other side, with the sensor {names[0]}",
        "use that sensor and the link {names[1]}",
    ),
    MistakeKind.MODULES: ("modules {names[0]} and {names[1]} are exchanged", "exchange their first_channel in the layout"),
    MistakeKind.CHANNELS: ("{names[0]}", "{names[1]}"),
    MistakeKind.WRENCH_POINT: (
        "the moments of the wrench are about {names[1]}, not about the origin of {names[0]}",
        'write about = "{names[1]}" in [wrench] of the scene',
    ),
    MistakeKind.WRENCH_LABEL: (
        "the wrench is in the frame of the sensor {names[1]}, though its messages name {names[0]}",
        'write frame = "{names[1]}" in [wrench] of the scene',
    ),
    MistakeKind.TOOL_INVERSE: (
        "the poses of the tool are inverse, those of the base in the tool's frame",
        "send the poses of the tool in the base",
    ),
    MistakeKind.TOOL_BASE: (
        "the base of the tool's poses is turned by half a turn about its z axis against that of base_from_link",
        "give base_from_link in the base of the poses: base and base_link of Universal Robots differ so",
    ),
    MistakeKind.TOOL_AXES: (
        "the poses of the tool have left-handed axes, or their positions other axes than their rotations",
        "send positions and rotations in one right-handed frame",
    ),
    MistakeKind.TOOL_POSE_OF_TIP: (
        "the poses of the tool are those of its tip, not of the flange",
        "send the pose of the flange, or write tip_mm = [0, 0, 0] into [tool], and the flange of a sensor in the frame of the "
        "tip",
    ),
    MistakeKind.TOOL_OTHER_TIP: (
        "the tip lies ({names[0]}, {names[1]}, {names[2]}) mm from tip_mm, in the tool's frame: this is another tool, or the "
        "robot has the tool centre point of another one",
        "correct tip_mm of [tool], or the tool centre point of the robot",
    ),
    MistakeKind.TOOL_MIRRORED: (
        "{names[0]} of the tool's poses are exchanged, or one of its axes points backwards: its base is left-handed",
        "turn the axes in the tracker's program or its driver, exchange none, and reverse none",
    ),
    MistakeKind.TOOL_PART_MOVED: (
        "the part or the base of the tool's poses moved by about {names[1]} mm before poke {names[0]}",
        "fix the part and exclude the pokes before it, which key E does for those selected in the Pokes tab, and "
        "`skincal pokes SESSION --exclude 1-{names[2]}` without a window. Then press the landmarks again",
    ),
    MistakeKind.TOOL_WRENCH: (
        "the wrench has the axes of the base, not those of the sensor",
        "send it in the axes of the sensor",
    ),
}
"""Mistake and remedy."""


def mistake_words(mistake: Mistake) -> tuple[str, str]:
    """Name a mistake, and its remedy as an order; neither has a full stop."""
    if mistake.is_reaction:
        says, opposite = mistake.names
        what = f"by [wrench] sign of the scene the sensor reports the {says}, but the pokes show the {opposite}"
        return what, "invert that sign, or use the correction of the sensor frame, not both"
    if mistake.kind in (MistakeKind.AXES, MistakeKind.UNITS):
        words = filter(None, (_turn_words(mistake.axes), _moment_unit_words(mistake.moment_scale / mistake.force_scale)))
        remedy = CORRECT_SENSOR if mistake.kind is MistakeKind.AXES else "set the sensor's unit in its address or its program"
        return "; ".join(words), remedy
    if mistake.form is not None:
        from skincal.words.tool_words import form_words  # slow to import

        return f"the rotation of the tool's poses is a {form_words(mistake.form)}", "correct rotation of [tool], or the sender"
    if mistake.kind is MistakeKind.LAYOUT:
        return _layout_words(mistake)
    if mistake.kind is MistakeKind.TOOL_TIP:
        shift = ", ".join(f"{value * 1e3:.0f}" for value in mistake.shift)
        return (
            f"the tip is elsewhere in the tool's frame than tip_mm, by ({shift}) mm",
            "check that the tool centre point is that of this tool, and make the fixed-point test (Session menu, or "
            "`skincal tool`)",
        )
    if mistake.kind is MistakeKind.TOOL_SENSOR_TURNED:
        turn = rotation_vector(mistake.motion[:3, :3])
        about = direction(turn / np.linalg.norm(turn))
        return (
            f"the sensor is turned by {_degrees(mistake.motion):.0f} degrees about ({about}) of its own axes against flange of "
            "[tool], as the weight of the tool shows",
            "turn flange by that, or send the wrench in the axes that flange gives",
        )
    if mistake.kind is MistakeKind.MESH_ORIGIN:
        shift = ", ".join(f"{value * 1e3:.0f}" for value in mistake.shift)
        if mistake.names:
            return f"the part must move by ({shift}) mm along its own axes", f"correct {mistake.names[0]}"
        return (
            f"mesh and layout must move by ({shift}) mm along the link's axes",
            "correct the origin of the mesh, or the position of the sensor or of [skin.anchor]",
        )
    what, remedy = _MISTAKE_WORDS[mistake.kind]
    return what.format(names=mistake.names, degrees=mistake.degrees), remedy.format(names=mistake.names)


def _turn_words(axes: FloatArray) -> str:
    """Describe wrong axes: a turn about one of them, or their order and signs; empty for right ones."""
    fixed = [axis for axis in range(3) if axes[axis, axis] == 1.0]
    if np.linalg.det(axes) > 0 and len(fixed) == 1:
        first, second = (fixed[0] + 1) % 3, (fixed[0] + 2) % 3
        degrees = round(float(np.degrees(np.arctan2(axes[second, first], axes[first, first]))))
        return f"the sensor is turned by {180 if degrees == -180 else degrees} degrees about its {'xyz'[fixed[0]]} axis"
    words = _axes_words(axes)
    return f"the sensor: {words}" if words else ""


def _layout_words(mistake: Mistake) -> tuple[str, str]:
    turned = f"turned by {mistake.degrees:.0f} degrees" if mistake.degrees else ""
    what = " and ".join(filter(None, ("mirrored" if mistake.mirrored else "", turned)))
    turn = f"turn x of [skin.anchor] by {mistake.degrees:.0f} degrees about its normal" if mistake.degrees else ""
    flip = MIRROR_REMEDY if mistake.mirrored else ""
    return f"the layout of the skin is {what}", ", and ".join(filter(None, (flip, turn)))


def frame_sentence(found: FrameDiagnosis, *, has_arm: bool) -> str:
    """Say whether the sensor frame is right, with the error at landmarks as reported and as corrected."""
    reported = millimetres(found.miss, 0)
    if found.wrench_frame and not found.right:
        return (
            f"The landmark pokes miss their landmarks by {reported}. First settle the wrench's frame, {found.wrench_frame}: "
            "[wrench] of the scene may name its frame, and the point of its moments (about)."
        )
    if found.mistake.kind is MistakeKind.TOOL_PART:
        shift = ", ".join(f"{value * 1e3:.0f}" for value in found.mistake.shift)
        return (
            f"The part is not where the scene says: it must move by ({shift}) mm and turn by "
            f"{_degrees(found.mistake.motion):.1f} degrees, in its own frame. Then the landmark pokes miss by "
            f"{millimetres(found.corrected_miss, 0)}, now by {reported}. Correct base_from_link of [tool]."
        )
    if not found.explained:
        return (
            f"The landmark pokes miss their landmarks by {reported}, and no known mistake of the sensor frame explains that. "
            "Press the landmarks again, and check their positions in the scene."
        )
    other_point = "."
    if found.other_point is not None:
        off = millimetres(found.other_point.miss, 0)
        other_point = f", but poke {found.other_point.poke} misses {found.other_point.name} by {off}: was it another point?"
    passes = f"{millimetres(found.corrected_miss, 0)}{other_point}"
    if found.right:
        # A right frame with a large error reads like a contradiction.
        whose = (
            f" This comes from other errors of {rig_name(has_arm)}, not from the frame."
            if found.corrected_miss > MENTION_RIG_ERRORS_ABOVE_MISS_M
            else ""
        )
        return f"The sensor frame {'is' if found.sure else 'looks'} right: pokes miss their landmarks by {passes}{whose}"
    wrong = f"The sensor frame looks wrong: {_frame_words(found.mistake)}."
    if reported == millimetres(found.corrected_miss, 0):
        return f"{wrong} The direction of the pushes shows it. The error at landmarks cannot show it: {passes}"
    return f"{wrong} Pokes miss their landmarks by {reported} now; corrected, by {passes}"


def _frame_words(found: Mistake) -> str:
    """Name a mistake of the sensor's frame."""
    if found.kind is MistakeKind.MOUNT:
        angle, shift = _degrees(found.motion), 1e3 * float(np.linalg.norm(found.motion[:3, 3]))
        return (
            f"the sensor is mounted about {angle:.0f} degrees and {shift:.0f} mm from where the scene says, or its calibration "
            "matrix is wrong"
        )
    return "; ".join(filter(None, (_axes_words(found.axes), _moment_unit_words(found.moment_scale / found.force_scale))))


def _degrees(motion: FloatArray) -> float:
    """Compute the angle of a motion (4, 4), degrees."""
    turn = motion[:3, :3]
    # arctan2 of both: the cosine is inaccurate for small angles, the sine near half a turn.
    sine = np.linalg.norm([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return float(np.degrees(np.arctan2(sine, np.trace(turn) - 1.0)))


def _moment_unit_words(moment_scale: float) -> str:
    """Name the unit of moments by the factor from reported to right ones, for right forces; empty for newton metres."""
    return {
        1.0: "",
        1e-3: "moments are in newton millimetres, not newton metres",
        1e-2: "moments are in newton centimetres, not newton metres",
        STANDARD_GRAVITY: "moments are in kilogram-force metres, forces in newtons",
        1.0 / STANDARD_GRAVITY: "forces are in kilogram-force, moments in newton metres",
    }[moment_scale]


def _axes_words(axes: np.ndarray) -> str:
    """Name a wrong order of the axes or their signs; empty if they are as reported."""
    # A row holds a single entry, 1 or -1: its sum is the sign.
    order, signs = np.abs(axes).argmax(axis=1).tolist(), axes.sum(axis=1).tolist()
    if order == [0, 1, 2]:
        turned = ["xyz"[axis] for axis, sign in enumerate(signs) if sign < 0]
        if len(turned) == 3:
            return "it reports the reaction force: all signs are inverted"
        return f"the sign of {', '.join(turned)} is inverted" if turned else ""
    named = [f"{'-' if sign < 0 else ''}{'xyz'[axis]}" for axis, sign in zip(order, signs, strict=True)]
    return f"its axes are in another order: x, y, z are {', '.join(named)}"

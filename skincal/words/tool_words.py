"""Sentences on the poses of a tool and the fixed-point test."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.contacts.pose_delays import DELAY_MIN_PRESSES, USED_DELAY_MAX_SD_S, PoseDelays
from skincal.geometry import FloatArray
from skincal.model.length_units import METRES_PER_UNIT
from skincal.model.pose_form import PoseForm, RotationForm
from skincal.model.tool_rig import ToolSpec
from skincal.rig.pivot import TOUCH_SD_MAX_M, Mistake, PivotFit, PivotResult, PivotState, PoseReading, TipMismatch, compare_tip
from skincal.words.units import degrees, direction, millimetres, point_mm

REPEATED_POSE_MIN_TAXELS = 3
"""Taxels that answered most at one pose of the tool. A poke between two pads may be either's."""
TIP_FAR_M = 1.0
"""m. No poking tool is as long."""
TURN_NAMED_FROM = math.radians(0.05)
"""rad, smallest turn of the sensor's axes that is named."""
DELAY_NOT_CORRECTED = (
    f"This is not corrected: it must be known to {USED_DELAY_MAX_SD_S * 1e3:.0f} ms. Move the tip faster to and from the skin."
)
FORM_WORDS = {
    RotationForm.QUATERNION_XYZW: "quaternion x y z w",
    RotationForm.QUATERNION_WXYZ: "quaternion w x y z",
    RotationForm.ROTATION_VECTOR: "rotation vector",
    RotationForm.RPY: "roll pitch yaw about fixed axes",
    RotationForm.ABC: "angles A B C about moving z y x",
    RotationForm.MOVING_XYZ: "angles about moving x y z",
    RotationForm.MOVING_ZYZ: "angles about moving z y z",
    RotationForm.ROWS: "matrix by rows",
    RotationForm.COLUMNS: "matrix by columns",
    RotationForm.AXIS_ANGLE: "unit axis and angle",
    RotationForm.MATRIX: "4 x 4 matrix by rows",
    RotationForm.MATRIX_COLUMNS: "4 x 4 matrix by columns",
}
_MISTAKE_WORDS = {
    Mistake.NONE: "",
    Mistake.ROTATION_INVERSE: ", inverted",
    Mistake.POSITION_Y_UP: ", with the position turned from y up to z up",
    Mistake.POSITION_Z_UP: ", with the position turned from z up to y up",
    Mistake.POSITION_YZ_EXCHANGED: ", with y and z of the position exchanged",
}
_MISMATCH_WORDS = {
    TipMismatch.INVERSE: "The touched point lies there: the poses are inverse, those of the base in the tool's frame.",
    TipMismatch.UNIT: "One of them is in another unit.",
    TipMismatch.POSE_OF_TIP: "The poses are those of the tip: the tool centre point of the controller contains it.",
    TipMismatch.POSE_OF_FLANGE: "The poses are those of the flange, or of a tool centre point that is not this tip.",
    TipMismatch.OTHER_TOOL: "Check the tool centre point: it may be that of another tool.",
}


def form_words(form: PoseForm) -> str:
    """Name a form of poses."""
    unit = (" in degrees" if form.degrees else " in radians") if form.rotation.has_angles else ""
    return FORM_WORDS[form.rotation] + unit


def reading_words(reading: PoseReading) -> str:
    """Name a reading of poses."""
    return form_words(reading.form) + _MISTAKE_WORDS[reading.mistake]


def pivot_sentences(result: PivotResult, known: FloatArray | None) -> list[str]:
    """Describe the result of the fixed-point test; `known` is a tip, (3,) float, metres, tool frame, if it is known."""
    fit, count = result.reading.fit, len(result.reading.fit.misses)
    scatter = f"{count} touches, read as {reading_words(result.reading)}, scatter by {millimetres(fit.touch_sd)}"
    tip = f"Tip in the tool's frame: {point_mm(fit.tip)} mm, known to {millimetres(fit.tip_sd)}."
    match result.state:
        case PivotState.OTHER_READING:
            better = result.others[0]
            return [
                f"{scatter}; read as {reading_words(better)}, by {millimetres(better.fit.touch_sd)}. "
                f"Change the setting of the poses."
            ]
        case PivotState.SCATTERED:
            worst = int(np.argmax(fit.misses))
            return [
                f"{scatter}, more than {millimetres(TOUCH_SD_MAX_M)}, and no other reading fits. Check that the point did not "
                f"move, that the tool is tight and its poses are not late. Touch {worst + 1} misses most, by "
                f"{millimetres(float(fit.misses[worst]))}."
            ]
        case PivotState.OPEN:
            return [
                f"{scatter}. The tip is known only to {millimetres(fit.tip_sd)} along {direction(fit.open_direction)} of the "
                "tool's axes. Touch the point again, with the tool leaning and turned in other directions."
            ]
        case PivotState.UNDECIDED:
            alike = " or ".join(reading_words(each) for each in result.similar_readings[:2])
            return [f"{scatter}; read as {alike} they fit as well. Touch the point again, with the tool leaning farther."]
        case PivotState.AGREES:
            return [f"{scatter}.", tip, *_tip_doubts(fit, known)]


def _tip_doubts(fit: PivotFit, known: FloatArray | None) -> list[str]:
    size = float(np.linalg.norm(fit.tip))
    if known is not None:
        mismatch = compare_tip(fit, known)
        if mismatch is None:
            return ["It agrees with the given tip."]
        away = millimetres(float(np.linalg.norm(fit.tip - known)))
        return [f"The given tip lies {away} from it. {_MISMATCH_WORDS[mismatch]}"]
    if size > TIP_FAR_M:
        return [f"It is {size:.1f} m long: check the unit, and whether the poses are those of the base in the tool's frame."]
    return []


def repeated_pose_sentence(contacts: Sequence[Contact]) -> str:
    """Describe pokes on several taxels with one pose of the tool, the same to the last bit; empty without any."""
    of_pose: dict[bytes, list[Contact]] = {}
    for contact in contacts:
        of_pose.setdefault(contact.link_from_sensor.tobytes(), []).append(contact)
    counted = [(len({poke.strongest_channel for poke in each}), len(each), each) for each in of_pose.values()]
    taxels, _, pokes = max(counted or [(0, 0, list(contacts))], key=lambda found: found[:2])
    if taxels < REPEATED_POSE_MIN_TAXELS:
        return ""
    return (
        f"tool: {len(pokes)} pokes on {taxels} taxels have the same pose of the tool to the last digit: its stream repeats "
        f"one pose. Their positions are wrong: check the program that sends the poses, and {exclude_words(pokes)}."
    )


def exclude_words(pokes: Sequence[Contact]) -> str:
    """Give the order to exclude pokes, in the window and without one."""
    numbers = sorted(poke.poke for poke in pokes)
    starts = [k for k, number in enumerate(numbers) if not k or number != numbers[k - 1] + 1]
    runs = [(numbers[k], numbers[(*starts, len(numbers))[row + 1] - 1]) for row, k in enumerate(starts)]
    listed = ",".join(f"{first}-{last}" if last > first else f"{first}" for first, last in runs)
    return f"exclude them (key E in the Pokes tab, or `skincal pokes SESSION --exclude {listed}`)"


def pose_delay_sentence(delays: PoseDelays | None) -> str:
    """Describe the delay of a tool's poses; empty while too few presses show it."""
    found = [] if delays is None else [(delays.against_wrench, "wrench"), (delays.against_skin, "skin")]
    known = [(delay, stream) for delay, stream in found if delay is not None]
    if not known:
        return ""
    ways = [
        f"{abs(delay.delay_s) * 1e3:.0f} ms {'later' if delay.delay_s >= 0.0 else 'earlier'} than the {stream}"
        for delay, stream in known
    ]
    first, stream = known[0]
    return (
        f"Poses of the tool come {' and '.join(ways)} (known to {first.sd_s * 1e3:.0f} ms, from {first.presses} presses). "
        + (f"The delay against the {stream} is corrected." if first.is_usable else DELAY_NOT_CORRECTED)
    )


def pose_stream_faults(delays: PoseDelays | None) -> tuple[str, ...]:
    """Name faults of the stream of a tool's poses: late beyond `LATE_POSES_MIN_S`, or with repeated values."""
    found: list[str] = []
    leading = None if delays is None else delays.leading
    if leading is not None and leading.is_late:
        side = "late" if leading.delay_s > 0.0 else "early"
        corrected = f"This is corrected, except in the first {DELAY_MIN_PRESSES} presses."
        found.append(
            f"Poses of the tool are {abs(leading.delay_s) * 1e3:.0f} ms {side}. "
            f"{corrected if leading.is_usable else DELAY_NOT_CORRECTED} Check the program that sends the poses: a buffer, a "
            "slow network, or stamps of another clock."
        )
    if delays is not None and delays.repeats:
        found.append(
            f"While the tool moves, its pose changes only every {delays.repeated_s:.2f} s: the stream is slow, or it repeats "
            "its values. Places between them are guessed. Send 50 poses a second, each of them measured."
        )
    return tuple(found)


def tool_facts(tool: ToolSpec) -> dict[str, str]:
    """Describe the settings of `[tool]`, each by its key in the scene."""
    unit = next((name for name, metres in METRES_PER_UNIT.items() if metres == tool.metres_per_unit), "")
    facts = {
        "sensor": "on the tool" if tool.has_sensor else "none",
        "poses": "as the stream defines them" if tool.form is None else f"{form_words(tool.form)}, lengths in {unit}",
        "tip_mm": "not given" if tool.tip is None else f"{point_mm(tool.tip)} mm in the tool's frame",
    }
    if tool.tip is not None:
        facts["tip_radius_mm"] = millimetres(tool.tip_radius)
        facts["tip_sd_mm"] = millimetres(tool.tip_sd)
    if tool.has_sensor:
        facts["flange"] = f"sensor at {point_mm(tool.tool_from_sensor[:3, 3])} mm in the tool's frame"
        cosine = (float(np.trace(tool.tool_from_sensor[:3, :3])) - 1.0) / 2.0
        angle = math.acos(min(1.0, max(-1.0, cosine)))
        facts["flange"] += f", turned by {degrees(angle, 1)}" if angle > TURN_NAMED_FROM else ", with its axes"
        facts["tolerance_deg"] = degrees(tool.turn_max, 1)
    return facts


def tool_findings(tool: ToolSpec, wrench_sign: int, *, finds_part_pose: bool) -> list[str]:
    """Describe the rig of a scene with a tool, in sentences without a full stop."""
    if tool.has_sensor:
        acts = (
            "the force on the tool: its opposite acts on the part" if wrench_sign < 0 else "the force of the tool on the part"
        )
        found = [
            "the sensor sits on the tool: a session needs the stream of its poses (field Tool, or --tool)",
            f"by [wrench] sign = {wrench_sign} the sensor reports {acts}",
        ]
    else:
        found = [
            "there is no force sensor: a poke is the place of the tip, and a session needs the stream of the tool's poses "
            "(field Tool, or --tool)"
        ]
    if finds_part_pose:
        found.append("pokes show the part's pose in the base of the tool's poses: all positions are in the base until then")
    else:
        frame = (
            "the part's frame" if tool.has_part_pose else "the base of the tool's poses: base_from_link of [tool] is not given"
        )
        found.append(f"all positions are in {frame}")
    if tool.form is None:
        found.append(
            "rotation of [tool] is not given: the stream must define the form of its poses, as `P` records of SKT/1 do"
        )
    return found

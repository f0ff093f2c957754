"""Sentences on pokes: why one was rejected, what to do better, and why a recording has none."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from skincal.contacts.outcome import RAW_UNIT, BeforePokes, Reason, Rejection
from skincal.contacts.poke_counts import PokeCounts
from skincal.model.actions import MissedLandmark
from skincal.model.readings import LinkHealth, Loss, Stream
from skincal.model.scene import ContactSettings
from skincal.model.tool_rig import TIP_ARM_POSE, TOOL_ARM_POSE
from skincal.words.link_words import link_name
from skincal.words.units import UNITS, count, grouped, millimetres, number, quantity

REASON_WORDS: Mapping[Reason, str] = {
    Reason.TOO_SOFT: "too soft",
    Reason.TOO_HARD: "too hard",
    Reason.NOT_STILL: "not held still",
    Reason.SLID: "tip slid",
    Reason.TWO_CONTACTS: "second touch?",
    Reason.NO_TAXEL: "no taxel answered",
    Reason.TOO_MANY_TAXELS: "too many taxels answered",
    Reason.NOT_CONNECTED: "taxels far apart answered",
    Reason.SATURATED: "force beyond the sensor's range",
    Reason.READINGS_LOST: "readings lost",
    Reason.NO_TARE: "no hands-off pause before it",
    Reason.TARE_CHANGED: "sensor zero changed",
    Reason.NO_POSE: "arm pose unknown",
    Reason.ARM_MOVED: "arm moved",
}
REJECTION_ADVICE: Mapping[Reason, str] = {
    Reason.TOO_SOFT: "Press harder, then hold.",
    Reason.TOO_HARD: "Press softer.",
    Reason.NOT_STILL: "Press, then hold still until the ring is full.",
    Reason.SLID: "Keep the tip in one place while you press.",
    Reason.TWO_CONTACTS: "Touch with the tip only, without a twist; keep the other hand off.",
    Reason.NO_TAXEL: "Press nearer to a taxel.",
    Reason.TOO_MANY_TAXELS: "Use a smaller tip, or press softer.",
    Reason.NOT_CONNECTED: "Something else touches the skin: remove it.",
    Reason.SATURATED: "Press softer.",
    Reason.READINGS_LOST: "The Devices tab shows which readings were lost or late.",
    Reason.NO_TARE: "Keep hands off for half a second before each poke.",
    Reason.TARE_CHANGED: "Keep hands off between pokes. If you did, the sensor drifts.",
    Reason.NO_POSE: "Choose the arm pose, or connect its joints.",
    Reason.ARM_MOVED: "Keep the arm still during a poke.",
}
MOST_ADDED_DECIMALS = 3
"""Decimals beyond those of a unit that tell a value from its limit."""
GAPS_MIN_SHARE = 0.2
"""Share of the time in quiet windows that gaps end, from which these are why no window was quiet."""
POLARITY_ADVICE = (
    "Keep hands off for half a second before each poke. If you did, the polarity is wrong: change it in [skin] of the scene, "
    'to "up" if values rise under pressure, to "down" if they fall.'
)
LATE_ANGLES_ADVICE = (
    "The joint angles have paused: start their program again. The poke counts if the next angles show that the arm rested."
)
FEW_FRAMES_ADVICE = "The skin sends too few readings: the Devices tab shows it. Or hold longer."
_TOOL_REASON_WORDS: Mapping[Reason, str] = {
    Reason.NO_POSE: "tool pose unknown",
    Reason.ARM_MOVED: "tool turned",
}
"""Words of a rig whose sensor sits on the tool, where they differ."""
_TOOL_ADVICE: Mapping[Reason, str] = {
    Reason.NO_POSE: "The stream of the tool's poses is late or silent: the Devices tab shows it.",
    Reason.ARM_MOVED: "Turn the tool first, wait half a second, then press without turning it.",
    Reason.NO_TARE: "Hold the tool still above the skin for half a second before each poke.",
    Reason.TARE_CHANGED: "Hold the tool still before and after each poke. If you did, the sensor drifts.",
}
_TIP_REASON_WORDS: Mapping[Reason, str] = {
    Reason.NO_POSE: "tool pose unknown",
    Reason.SLID: "tip moved",
    Reason.NO_TARE: "no pause before it",
}
"""Words of a rig without a force sensor, where they differ."""
_TIP_ADVICE: Mapping[Reason, str] = {
    Reason.NO_POSE: _TOOL_ADVICE[Reason.NO_POSE],
    Reason.NOT_STILL: "Press, then hold the tip still.",
    Reason.SLID: "Press, then hold the tip still until the ring is full.",
    Reason.NO_TARE: "Hold the tip above the skin for half a second before each poke.",
}
MISSED_ADVICE = "Press the landmark itself. If you did, its position in the scene may be wrong; N skips it."
"""Advice after a poke too far from the requested landmark."""
_SHORT_REASONS: Mapping[Reason, str] = {
    Reason.NOT_CONNECTED: "far apart",
    Reason.NO_TARE: "no pause",
    Reason.TARE_CHANGED: "zero changed",
    Reason.TOO_MANY_TAXELS: "too many",
    Reason.SATURATED: "out of range",
}
"""Short reasons for a narrow column; the other reasons fit there with their number."""


def poke_count_words(counts: PokeCounts, why: str = "") -> str:
    """Count pokes by what became of them: `"18 pokes: 8 accepted, 9 at landmarks, 1 rejected"`.

    `why` follows the number of rejected ones.
    """
    at_landmarks = counts.at_landmarks + counts.on_both
    both = f" ({grouped(counts.on_both)} of them accepted, too)" if counts.on_both else ""
    parts = {
        "accepted": counts.accepted, f"at landmarks{both}": at_landmarks, f"rejected{why}": counts.rejections,
        "excluded": counts.excluded,
    }  # fmt: skip
    listed = ", ".join(f"{grouped(number_of)} {what}" for what, number_of in parts.items() if number_of)
    return ": ".join(filter(None, (count(counts.pokes, "poke"), listed)))


def is_of_tool(rejection: Rejection) -> bool:
    """Whether a poke was made with a tool whose poses are streamed."""
    return rejection.pose in (TOOL_ARM_POSE, TIP_ARM_POSE)


def reason_words(rejection: Rejection) -> str:
    """Say why a poke was rejected, without its number."""
    return words_of_reason(rejection.reason, rejection.pose)


def words_of_reason(reason: Reason, arm_pose: str) -> str:
    """Say why pokes in an arm pose were rejected: a rig with a tool has words of its own for some reasons."""
    words = REASON_WORDS[reason]
    return {TOOL_ARM_POSE: _TOOL_REASON_WORDS, TIP_ARM_POSE: _TIP_REASON_WORDS}.get(arm_pose, {}).get(reason, words)


def rejection_words(rejection: Rejection) -> str:
    """Say why a poke was rejected, with number and limit: `"tip slid 2.1 mm (limit 1.5 mm)"`."""
    reason, value, limit = rejection.reason, rejection.value, rejection.limit
    words = reason_words(rejection)
    if answered_inversely(rejection):
        return f"{words}; taxels changed against the scene's polarity"
    if rejection.unit == RAW_UNIT and math.isfinite(value):
        return f"{words}: strongest response {number(value, 1)}, needs {number(limit, 1)}"
    if has_late_angles(rejection):
        old = "its last pose is" if is_of_tool(rejection) else "its joint angles are"
        return f"{words}: {old} {quantity(value, 's')} old (limit {quantity(limit, 's')})"
    if reason is Reason.NO_POSE and value > limit:
        return f"{words}: {count(round(value), 'skin frame')} without a pose"
    if reason in (Reason.NO_TAXEL, Reason.NO_POSE, Reason.SATURATED) or not (math.isfinite(value) and math.isfinite(limit)):
        return words
    bound = "needs" if value < limit else "limit"
    if reason is Reason.NOT_STILL and rejection.unit == "s":
        return f"held still for only {quantity(value, 's')} ({bound} {quantity(limit, 's')})"
    if has_few_frames(rejection):
        return f"held still for only {count(round(value), 'skin frame')} in a row ({bound} {round(limit)})"
    colon = "" if reason is Reason.SLID else ":"
    if rejection.unit == "1":
        return f"{words}{colon} {number(100.0 * value, 1)} % ({bound} {number(100.0 * limit, 1)} %)"
    decimals = _decimals_apart(value, limit, rejection.unit)
    return f"{words}{colon} {quantity(value, rejection.unit, decimals)} ({bound} {quantity(limit, rejection.unit, decimals)})"


def _decimals_apart(value: float, limit: float, unit: str) -> int | None:
    """Choose the decimals that keep value and limit apart: *1° (limit 1°)* contradicts itself; `None` if the unit's do."""
    known = UNITS.get(unit)
    if known is None or quantity(value, unit) != quantity(limit, unit):
        return None
    decimals = range(known.decimals + 1, known.decimals + MOST_ADDED_DECIMALS + 1)
    apart = (each for each in decimals if quantity(value, unit, each) != quantity(limit, unit, each))
    return next(apart, None)


def answered_inversely(rejection: Rejection) -> bool:
    """Whether taxels changed by more than their threshold in the other direction, and none answered.

    Before the first answer of a session this looks like a zero that was taken while something pressed (`ContactDetector`).
    """
    if rejection.reason is Reason.NO_TARE:
        return rejection.value == 0.0
    return rejection.reason is Reason.NO_TAXEL and rejection.unit == RAW_UNIT and rejection.value < -rejection.limit


def has_late_angles(rejection: Rejection) -> bool:
    """Whether joint angles or tool pose of a poke came too long before it: arm or tool may have moved since then."""
    return rejection.reason is Reason.NO_POSE and rejection.unit == "s"


def has_few_frames(rejection: Rejection) -> bool:
    """Whether a press was long enough, and too few frames of the skin came in a row for a still window."""
    return rejection.reason is Reason.NOT_STILL and rejection.unit == ""


def late_angles_sentence(rejections: Sequence[Rejection]) -> str:
    """Count the pokes without joint angles in a sentence, or return an empty string."""
    late = [each for each in rejections if has_late_angles(each)]
    if not late:
        return ""
    pokes = len(late)
    if is_of_tool(late[0]):
        return (
            f"tool: {count(pokes, 'poke')} without a pose of the tool: the last ones before are too old. They do not count; "
            "check the program that sends the poses."
        )
    return (
        f"joints: {count(pokes, 'poke')} without joint angles: the last ones before are too old, and the next ones differ or "
        "never came. Their arm pose is unknown, and they do not count."
    )


def rejection_advice(rejection: Rejection) -> str:
    """Advise the operator after a rejected poke."""
    if has_few_frames(rejection):
        return FEW_FRAMES_ADVICE
    advice = {TOOL_ARM_POSE: _TOOL_ADVICE, TIP_ARM_POSE: _TIP_ADVICE}.get(rejection.pose, {})
    if rejection.reason in advice and not answered_inversely(rejection):
        return advice[rejection.reason]
    if has_late_angles(rejection):
        return LATE_ANGLES_ADVICE
    return POLARITY_ADVICE if answered_inversely(rejection) else REJECTION_ADVICE[rejection.reason]


def short_rejection(rejection: Rejection) -> str:
    """Say why a poke was rejected in few words, with its number: `"tip slid 2.1 mm"`."""
    if rejection.reason is Reason.NO_POSE:
        return reason_words(rejection)
    words = rejection_words(rejection).partition(" (")[0].replace(":", "").replace(" response", "")
    words = words.replace("held still for only", "held").partition(", needs")[0]
    full = reason_words(rejection)
    return words.replace(full, _SHORT_REASONS.get(rejection.reason, full))


def missed_words(missed: MissedLandmark) -> str:
    """Format the distance of a poke from the requested landmark: `"52 mm beside wrist, top (limit 34 mm)"`."""
    if missed.behind:
        return f"not on the side of {missed.name}"
    return f"{millimetres(missed.miss, 0)} from {missed.name} (limit {millimetres(missed.limit, 0)})"


WHOLE_RECORDINGS = "Give the whole recordings of one run."


def _find_numberless(links: Sequence[LinkHealth]) -> LinkHealth | None:
    """Find a link whose readings are mostly NaN or infinite; `None` if there is none."""
    return next((link for link in links if link.link != Stream.JOINTS.value and 2 * link.numberless > link.readings), None)


def too_short_sentence(
    seen: BeforePokes, thresholds: ContactSettings, links: Sequence[LinkHealth] = (), *, has_sensor: bool = True
) -> str:
    """Explain why a recording is too short for any poke; empty if it is long enough, or NaN is the cause."""
    needed_s = thresholds.quiet_s + thresholds.still_s
    if not seen.samples or seen.seconds >= needed_s or _find_numberless(links) is not None:
        return ""
    streams = "Force and skin were recorded together" if has_sensor else "The skin was recorded"
    return (
        f"{streams} for {seen.seconds:.2g} s; a poke needs {needed_s:g} s: "
        f"{thresholds.quiet_s:g} s without a touch and {thresholds.still_s:g} s of holding still."
    )


def unnamed_landmarks_sentence(landmarks: Sequence[str], pokes: int, folder: str, *, is_placed: bool) -> str:
    """Name the command that gives pokes their landmarks; empty without `landmarks`, or `pokes` that can be at one.

    Parameters
    ----------
    landmarks : names of those without a poke
    pokes : number of the pokes that no taxel answered and that are at no landmark
    """
    if not landmarks or not pokes:
        return ""
    how = (
        f"`skincal landmarks {folder} --find` names them, or Shift+K in the window, where it is sure"
        if is_placed
        else f"`skincal landmarks {folder} --find` names them by the shape of the touched points, --order in their order, or "
        "--at one by one; three show the part's pose"
    )
    at = count(len(landmarks), "landmark has no poke", "landmarks have no poke")
    return f"{at}, and no taxel answered {count(pokes, 'poke')}: {how}."


def no_poke_sentence(
    seen: BeforePokes, thresholds: ContactSettings, links: Sequence[LinkHealth] = (), *, has_sensor: bool = True
) -> str:
    """Describe a recording without a poke: its content, the needs of a poke, and the next check."""
    mostly = _find_numberless(links)
    if mostly is not None:
        return (
            f"No poke was found: {mostly.numberless} of the {mostly.readings} readings of the {link_name(mostly)} are NaN or "
            "infinite. Check the sensor and the program that published them."
        )
    if not has_sensor:
        return _no_tip_poke_sentence(seen, thresholds)
    if not seen.samples:
        return (
            "No poke was found: the force/torque readings and the skin readings never overlap in time. "
            "Check that the recordings belong together."
        )
    if too_short := too_short_sentence(seen, thresholds):
        return f"No poke was found. {too_short}"
    looked = f"No poke was found in {count(seen.samples, 'skin reading')} with force, over {seen.seconds:.0f} s"
    if not seen.tared and seen.gaps * thresholds.quiet_s > GAPS_MIN_SHARE * seen.seconds:
        skin = next((link for link in links if link.link == Stream.SKIN.value), None)
        unpaired = 0 if skin is None else sum(skin.losses.get(loss, 0) for loss in (Loss.UNPAIRED, Loss.LATE))
        stream = "force/torque sensor" if unpaired > seen.gaps else "skin"
        return (
            f"{looked}: the readings of the {stream} have {seen.gaps} gaps, the longest of {seen.longest_gap_s:.2g} s; "
            f"expected {thresholds.quiet_s:g} s without a gap and without a touch before a poke. Check what hands them on: "
            "cable, adapter, network and program."
        )
    if not seen.tared:
        return (
            f"{looked}: the force was never steady; expected {thresholds.quiet_s:g} s without a touch before a poke. "
            "Check the noise of the force/torque sensor and the unit of its readings."
        )
    if seen.answered:
        skin, check = f"{count(seen.answered, 'taxel')} answered", "the unit of the force"
    elif seen.fell:
        skin = f"no taxel answered, but the readings of {seen.fell} fell"
        check = "the skin's polarity in the scene and the unit of the force"
    else:
        skin, check = "no taxel answered", "that the part was pressed, and the unit of the force"
    return (
        f"{looked}: the largest change of force is {seen.strongest:.2g} N, and {skin}. A poke needs "
        f"{thresholds.touch_force:g} N or more. Check {check}, or lower touch_force in the scene's [contacts]."
    )


def _no_tip_poke_sentence(seen: BeforePokes, thresholds: ContactSettings) -> str:
    """Describe a recording without a poke of a rig that has no force sensor."""
    if not seen.samples:
        return "No poke was found: no frame of the skin could be used. Check the format and the width of its frames."
    looked = f"No poke was found in {count(seen.samples, 'skin frame')}, over {seen.seconds:.0f} s"
    if not seen.tared:
        return (
            f"{looked}: the skin was never at rest for {thresholds.quiet_s:g} s. Hold the tip off the skin before each poke, "
            "and check the noise of the skin."
        )
    if seen.fell and not seen.answered:
        return (
            f"{looked}: no taxel answered, but the readings of {seen.fell} fell: check polarity in [skin] of the scene, and "
            f"response_min of [contacts] ({thresholds.response_min:g} now)."
        )
    return (
        f"{looked}: no taxel answered by response_min of [contacts] ({thresholds.response_min:g}), and no touch of a landmark "
        "was seen: the tip comes, rests, and goes back the same way. Check that the part was touched, and the tool's poses."
    )

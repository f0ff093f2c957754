"""Sentences on sensor and arm: corrections, landmarks, the sensor frame and the final check."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt

import numpy as np

from skincal.rig.closing import Closing, ClosingPlaces
from skincal.rig.correction import FRAME, UsedCorrection
from skincal.rig.correction_fit import (
    MAX_HELD_OUT_ERROR_RATIO_TO_CORRECT,
    MIN_LANDMARK_POKES,
    MIN_LANDMARKS,
    REPORT_LANDMARK_POKES_WITH_TRUST_BELOW,
    RigAnswer,
)
from skincal.rig.frame_check import STANDARD_GRAVITY, FrameCorrection, FrameDiagnosis
from skincal.words.units import millimetres

MENTION_RIG_ERRORS_ABOVE_MISS_M = 0.005
"""Landmark miss above which a sentence on a right frame names errors of sensor and arm; noise and hand cause 1 to 3 mm."""


def closing_sentence(closing: Closing) -> str:
    """Say whether anything moved between the first pokes of a session and their repetition at its end."""
    moved, limit = millimetres(closing.shift), millimetres(closing.limit)
    across = "" if closing.observable_directions == 3 else ", measured only across the direction of the press"
    where = f"{len(closing.names)} {closing.at.value} pressed again{across}"
    what = "the sensor or the arm" if closing.at is ClosingPlaces.LANDMARKS else "the sensor, the arm or the skin"
    if closing.single_poke_decides:
        place = closing.place if closing.at is ClosingPlaces.LANDMARKS else f"taxel {closing.place}"
        return (
            f"Only poke {closing.poke} at {place} indicates that {what} moved by {moved} since the start ({where}; noise "
            f"explains up to {limit}). The tip may have slid: press {place} again, or repeat the final check."
        )
    if not closing.has_moved:
        return f"Nothing has moved since the start: {moved} at {where} (noise explains up to {limit})."
    return (
        f"Since the start {what} has moved by {moved} ({where}; noise explains up to {limit}). Fasten it, and repeat the final "
        "check."
    )


def earlier_closings(closings: Sequence[Closing]) -> list[str]:
    """Summarise the final checks before the last one in a sentence; empty if there was only one."""
    found = [f"{millimetres(each.shift)} after poke {each.after}{_judged(each)}" for each in closings[:-1]]
    return [f"Earlier checks: {', '.join(found)}."] if found else []


def _judged(closing: Closing) -> str:
    if closing.single_poke_decides:
        return f" (only poke {closing.poke})"
    return " (moved)" if closing.has_moved else ""


def correction_words(used: UsedCorrection) -> str:
    """Describe a correction, with the error before and after; without a full stop, since files use it in comments."""
    after, before = millimetres(used.after), millimetres(used.before)
    if used.of == FRAME:
        return f"the sensor frame is corrected from {used.pokes} landmark pokes: their error falls from {before} to {after}"
    errors = f"the error at landmarks left out of the fit falls from {before} to {after}"
    return f"sensor and arm are corrected from {used.pokes} landmark pokes: {errors}"


def correction_sentence(used: UsedCorrection) -> str:
    """Make a sentence of `correction_words`."""
    words = correction_words(used)
    return f"{words[0].upper()}{words[1:]}."


def rig_sentences(answer: RigAnswer) -> tuple[str, ...]:
    """Say whether sensor and arm can be corrected, then which landmark pokes count less."""
    if answer.correction is None:
        needs = f"it needs {MIN_LANDMARK_POKES} pokes at {MIN_LANDMARKS} different landmarks"
        return (f"No correction of sensor and arm: {needs}; there are {len(answer.trust)} pokes at {answer.points}.",)
    before, after = millimetres(answer.before), millimetres(answer.after)
    errors = f"the error at landmarks left out of the fit is {after}, without a correction {before}"
    first = f"A correction of sensor and arm is ready: {errors}."
    if not answer.used:
        wanted = millimetres(answer.before * sqrt(MAX_HELD_OUT_ERROR_RATIO_TO_CORRECT))
        first = f"Sensor and arm are not corrected: {errors}; below {wanted} a correction would be offered."
    doubted = [
        f"Landmark poke {poke} is {millimetres(answer.distances[poke], 0)} from its landmark and "
        + ("does not count: was it another point?" if trust <= 0 else f"counts {trust:.0%}.")
        for poke, trust in answer.trust.items()
        if trust < REPORT_LANDMARK_POKES_WITH_TRUST_BELOW
    ]
    return (first, *doubted)


def frame_sentence(found: FrameDiagnosis) -> str:
    """Say whether the sensor frame is right, with the error at landmarks as reported and as corrected."""
    reported = millimetres(found.miss, 0)
    if found.wrench_frame and not found.right:
        return (
            f"The landmark pokes miss their landmarks by {reported}. First settle the wrench's frame, {found.wrench_frame}: "
            "[wrench] of the scene may name its frame, and the point of its moments (about)."
        )
    if not found.explained:
        return (
            f"The landmark pokes miss their landmarks by {reported}, and no known mistake of the sensor frame explains that. "
            "Press the landmarks again, and check their positions in the scene."
        )
    slip = "."
    if found.slip is not None:
        off = millimetres(found.slip.miss, 0)
        slip = f", but poke {found.slip.poke} misses {found.slip.name} by {off}: was it another point?"
    passes = f"{millimetres(found.corrected_miss, 0)}{slip}"
    if found.right:
        # A right frame with a large error reads like a contradiction.
        whose = (
            " This comes from other errors of sensor and arm, not from the frame."
            if found.corrected_miss > MENTION_RIG_ERRORS_ABOVE_MISS_M
            else ""
        )
        return f"The sensor frame {'is' if found.sure else 'looks'} right: pokes miss their landmarks by {passes}{whose}"
    wrong = f"The sensor frame looks wrong: {_mistake_words(found.correction)}."
    return f"{wrong} Pokes miss their landmarks by {reported} now; corrected, by {passes}"


def _mistake_words(found: FrameCorrection) -> str:
    """Name the mistake of a frame that needs this correction."""
    if not np.array_equal(found.motion, np.eye(4)):
        turn, shift = found.motion[:3, :3], 1e3 * float(np.linalg.norm(found.motion[:3, 3]))
        # arctan2 of both: the cosine is inaccurate for small angles, the sine near half a turn.
        sine = np.linalg.norm([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
        angle = np.degrees(np.arctan2(sine, np.trace(turn) - 1.0))
        return (
            f"the sensor is mounted about {angle:.0f} degrees and {shift:.0f} mm from where the scene says, or its calibration "
            "matrix is wrong"
        )
    return "; ".join(filter(None, (axes_words(found.axes), moment_unit_words(found.moment_scale / found.force_scale))))


def moment_unit_words(moment_scale: float) -> str:
    """Name the unit of moments by the factor from reported to right ones, for right forces; empty for newton metres."""
    return {
        1.0: "",
        1e-3: "moments are in newton millimetres, not newton metres",
        1e-2: "moments are in newton centimetres, not newton metres",
        STANDARD_GRAVITY: "moments are in kilogram-force metres, forces in newtons",
        1.0 / STANDARD_GRAVITY: "forces are in kilogram-force, moments in newton metres",
    }[moment_scale]


def axes_words(axes: np.ndarray) -> str:
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

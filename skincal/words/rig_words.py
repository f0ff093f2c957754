"""Sentences on sensor and arm: corrections, landmarks, the sensor frame and the final check."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from skincal.rig.closing import Closing, ClosingPlaces
from skincal.rig.correction import FRAME, UsedCorrection
from skincal.rig.correction_fit import DOUBTED, FEWEST, FEWEST_POINTS, RigAnswer
from skincal.rig.frame_check import GRAVITY, FrameCorrection, FrameDiagnosis

if TYPE_CHECKING:
    pass


OF_RIG = 0.005
"""m. Pokes that pass their landmarks at more under a right frame show errors of the rig: noise and a hand make 1 to 3 mm."""


def closing_sentence(closing: Closing) -> str:
    """Return whether anything moved between a session's first pokes and those made once more at its end."""
    moved, limit = f"{closing.shift * 1e3:.1f} mm", f"{closing.limit * 1e3:.1f} mm"
    across = "" if closing.seen == 3 else ", across their pushes"
    where = f"{len(closing.names)} {closing.at.value} that were poked once more{across}"
    what = "the sensor or the arm" if closing.at is ClosingPlaces.LANDMARKS else "the sensor, the arm or the skin"
    if closing.hangs_on_one:
        place = closing.place if closing.at is ClosingPlaces.LANDMARKS else f"taxel {closing.place}"
        return (
            f"Only poke {closing.poke} at {place} says that {what} has moved since the start, by {moved} ({where}; noise alone "
            f"makes up to {limit}). The others do not, so it may have slipped: poke {place} once more, or check again."
        )
    if not closing.moved:
        return f"Nothing is seen to have moved since the start: {moved} at {where}, and noise alone makes up to {limit}."
    return (
        f"Since the start {what} has moved by {moved} ({where}; noise alone makes up to {limit}): fasten it, and check again."
    )


def earlier_closings(closings: Sequence[Closing]) -> list[str]:
    """Return what the closing checks before the last one found, in a sentence; none where there was none."""
    found = [f"{each.shift * 1e3:.1f} mm after poke {each.after}{_judged(each)}" for each in closings[:-1]]
    return [f"Checked before: {', '.join(found)}."] if found else []


def _judged(closing: Closing) -> str:
    if closing.hangs_on_one:
        return f" (only poke {closing.poke} says so)"
    return " (moved)" if closing.moved else ""


def correction_words(used: UsedCorrection) -> str:
    """Return what was corrected, with the miss before and after; no full stop, since files put it into comments."""
    after, before = f"{used.after * 1e3:.1f} mm", f"{used.before * 1e3:.1f} mm"
    who = "they" if used.of == FRAME else "held-out ones"
    what = "the sensor's frame" if used.of == FRAME else "the rig"
    misses = f"{who} pass their landmarks at {after} with it, at {before} without"
    return f"{what} is corrected from {used.pokes} landmark pokes: {misses}"


def correction_sentence(used: UsedCorrection) -> str:
    """Return `correction_words` as a sentence."""
    words = correction_words(used)
    return f"{words[0].upper()}{words[1:]}."


def rig_sentences(answer: RigAnswer) -> tuple[str, ...]:
    """Return whether a rig can be corrected, then which landmark pokes count less."""
    if answer.correction is None:
        needs = f"it needs {FEWEST} pokes at landmarks, {FEWEST_POINTS} different ones"
        return (f"No correction of the rig: {needs}; {len(answer.trust)} pokes at {answer.points} are there.",)
    before, after = f"{answer.before * 1e3:.1f} mm", f"{answer.after * 1e3:.1f} mm"
    misses = f"held-out pokes pass their landmarks at {after} with a correction made without them, at {before} without any"
    first = f"The rig can be corrected: {misses}." if answer.used else f"The rig is left as it is: {misses}."
    doubted = [
        f"Landmark poke {poke} lies {answer.distances[poke] * 1e3:.0f} mm off its landmark and counts "
        + ("for nothing: was it another point?" if trust <= 0 else f"{trust:.0%}.")
        for poke, trust in answer.trust.items()
        if trust < DOUBTED
    ]
    return (first, *doubted)


def frame_sentence(found: FrameDiagnosis) -> str:
    """Return what landmark pokes say of the sensor's frame, with the miss as reported and as corrected."""
    reported = f"{found.miss * 1e3:.0f} mm"
    if not found.explained:
        return (
            f"No known mistake of the frame explains these pokes: they pass their landmarks at {reported}; poke again, and "
            "look at the landmarks' places."
        )
    slip = "."
    if found.slip is not None:
        off = f"{found.slip.miss * 1e3:.0f} mm"
        slip = f", but poke {found.slip.poke} passes {found.slip.name} at {off}: was it another point?"
    passes = f"{found.corrected_miss * 1e3:.0f} mm{slip}"
    if found.right:
        # Right, and off by a centimetre, reads like a contradiction.
        whose = " That is errors of the rig, not of its frame." if found.corrected_miss > OF_RIG else ""
        return f"The sensor's frame {'is' if found.sure else 'looks'} right: pokes pass their landmarks at {passes}{whose}"
    wrong = f"The sensor's frame looks wrong: {_mistake_words(found.correction)}."
    return f"{wrong} As reported, pokes pass their landmarks at {reported}; so corrected, at {passes}"


def _mistake_words(found: FrameCorrection) -> str:
    """Return what is wrong with a frame that needs this correction."""
    if not np.array_equal(found.motion, np.eye(4)):
        turn, shift = found.motion[:3, :3], 1e3 * float(np.linalg.norm(found.motion[:3, 3]))
        # Of a small turn the cosine has no digits, of one near a half turn the sine has none.
        sine = np.linalg.norm([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
        angle = np.degrees(np.arctan2(sine, np.trace(turn) - 1.0))
        return (
            f"the sensor sits elsewhere on the arm than reported, by about {angle:.0f} degrees and {shift:.0f} mm, or its "
            "matrix is far off"
        )
    return "; ".join(filter(None, (_axes_words(found.axes), _unit_words(found))))


def _unit_words(found: FrameCorrection) -> str:
    if found.force_scale == GRAVITY:
        return "the forces are kilogram-force beside newton metres"
    return {
        1.0: "",
        1e-3: "the moments are newton millimetres, not newton metres",
        1e-2: "the moments are newton centimetres, not newton metres",
        GRAVITY: "the moments are kilogram-force metres beside newtons",
    }[found.moment_scale]


def _axes_words(axes: np.ndarray) -> str:
    """Return what an order of the axes with signs is, in words; empty for the one reported."""
    # A row holds a single entry, 1 or -1: its sum is the sign.
    order, signs = np.abs(axes).argmax(axis=1).tolist(), axes.sum(axis=1).tolist()
    if order == [0, 1, 2]:
        turned = ["xyz"[axis] for axis, sign in enumerate(signs) if sign < 0]
        if len(turned) == 3:
            return "it reports the reaction: all signs are turned"
        return f"the sign of {', '.join(turned)} is turned" if turned else ""
    named = [f"{'-' if sign < 0 else ''}{'xyz'[axis]}" for axis, sign in zip(order, signs, strict=True)]
    return f"its axes are reported in another order: x, y, z are {', '.join(named)}"

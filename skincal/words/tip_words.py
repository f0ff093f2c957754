"""Sentences on a stream of tip positions."""

from __future__ import annotations

import math

from skincal.rig.tip_frame import TIP_FRAME_MIN_POKES, TIP_SD_MAX_M, TipFrame, TipState
from skincal.words.units import millimetres

MILLIMETRE_RATIO, RATIO_TOLERANCE = 0.001, 20.0


def tip_sentence(frame: TipFrame) -> str:
    """Describe the frame of the tip positions and their use."""
    match frame.state:
        case TipState.USED:
            turn = f"{math.degrees(frame.turn_sd):.1f} degrees"
            return (
                f"Robot base: known to {millimetres(frame.shift_sd)} and {turn}, from {frame.pokes} pokes. "
                f"Tip positions are used; they scatter by {millimetres(frame.tip_sd)}."
            )
        case TipState.FEW_POKES:
            return f"Robot base: unknown. Tip positions are used from {TIP_FRAME_MIN_POKES} pokes on."
        case TipState.AMBIGUOUS:
            return (
                f"Robot base: not yet known after {frame.pokes} pokes. Tip positions are not used. "
                "Press more sides of the part, in different directions."
            )
        case TipState.WRONG_UNIT:
            is_mm = MILLIMETRE_RATIO / RATIO_TOLERANCE < frame.ratio < MILLIMETRE_RATIO * RATIO_TOLERANCE
            seen = "they look like millimetres" if is_mm else f"they span {1.0 / frame.ratio:.2g} times the part"
            return f"Tip positions are not used: {seen}; expected metres. Correct the unit of the tip stream."
        case TipState.DISAGREES:
            return (
                f"Tip positions are not used: they miss the force axes by {millimetres(frame.tip_sd)}, "
                f"more than {millimetres(TIP_SD_MAX_M)}. Check that they are of the tip, in one fixed frame, and not late."
            )

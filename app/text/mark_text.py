"""Meanings of the marks of taxels, as the window's maps draw them."""

from __future__ import annotations

from collections.abc import Mapping

from app.state.policies import GOOD_RMS, Mark
from skincal.taxels.result import State
from skincal.words.units import millimetres

MARK_WORDS: Mapping[Mark, str] = {
    Mark.UNSEEN: State.UNSEEN.value,
    Mark.BLIND: State.BLIND.value,
    Mark.INFERRED: f"{State.INFERRED.value} (no contact of its own that counts)",
    Mark.ROUGH: f"{State.TOUCHED.value}, expected error above {millimetres(GOOD_RMS, 0)}",
    Mark.GOOD: f"{State.TOUCHED.value}, expected error up to {millimetres(GOOD_RMS, 0)}",
    Mark.FINISHED_INFERRED: f"{State.INFERRED.value} (no contact of its own that counts), finished",
    Mark.FINISHED: f"{State.TOUCHED.value}, finished",
    Mark.DEAD: State.DEAD.value,
}

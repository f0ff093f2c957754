"""Meanings of the marks of taxels, as the window's maps draw them.

The colour of a taxel is its module (`MODULE_HUES` of `app/theme.py`); its state is the shape of its mark
(`app/panels/taxel_map.py`, `mark_path`), chosen by `app/state/policies.py`, `marks`.
"""

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
"""In full."""
GOOD_MM = millimetres(GOOD_RMS, 0)
LEGEND_WORDS: Mapping[Mark, tuple[str, str]] = {
    Mark.UNSEEN: ("\N{WHITE CIRCLE}", State.UNSEEN.value),
    Mark.BLIND: ("\N{CIRCLE WITH UPPER RIGHT QUADRANT BLACK}", State.BLIND.value),
    Mark.INFERRED: ("\N{BULLSEYE}", State.INFERRED.value),
    Mark.ROUGH: ("\N{CIRCLE WITH RIGHT HALF BLACK}", f"{State.TOUCHED.value}, error > {GOOD_MM}"),
    Mark.GOOD: ("\N{BLACK CIRCLE}", f"{State.TOUCHED.value}, error \N{LESS-THAN OR EQUAL TO} {GOOD_MM}"),
    Mark.FINISHED_INFERRED: ("\N{WHITE SQUARE CONTAINING BLACK SMALL SQUARE}", f"{State.INFERRED.value}, finished"),
    Mark.FINISHED: ("\N{BLACK SQUARE}", f"{State.TOUCHED.value}, finished"),
    Mark.DEAD: ("\N{BALLOT X}", State.DEAD.value),
}
"""Sign and short words of the legend."""

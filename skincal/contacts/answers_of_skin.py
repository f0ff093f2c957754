"""The choice of the answers of a skin: one value for each taxel, or three."""

from __future__ import annotations

from skincal.contacts.taxel_answers import TaxelAnswers
from skincal.model.scene import SkinSpec


def answers_of(skin: SkinSpec) -> TaxelAnswers:
    """Make the answers of a skin."""
    if skin.axes is None:
        return TaxelAnswers(skin)
    from skincal.contacts.vector_answers import VectorAnswers  # only for skins of three axes

    return VectorAnswers(skin, skin.axes)

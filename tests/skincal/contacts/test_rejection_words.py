"""The numbers in the reason of a rejected poke."""

import numpy as np
import pytest

from skincal.contacts.outcome import Reason, Rejection
from skincal.model.tool_rig import TOOL_ARM_POSE
from skincal.words.poke_words import rejection_words


@pytest.mark.parametrize(
    ("reason", "value", "limit", "unit", "words"),
    [
        (Reason.ARM_MOVED, np.radians(2.0), np.radians(1.0), "rad", "tool turned: 2° (limit 1°)"),
        (Reason.ARM_MOVED, np.radians(1.3), np.radians(1.0), "rad", "tool turned: 1.3° (limit 1.0°)"),
        (Reason.ARM_MOVED, np.radians(1.003), np.radians(1.0), "rad", "tool turned: 1.003° (limit 1.000°)"),
        (Reason.ARM_MOVED, np.radians(1.0) * (1.0 + 1e-9), np.radians(1.0), "rad", "tool turned: 1° (limit 1°)"),
        (Reason.SLID, 1.52e-3, 1.5e-3, "m", "tip slid 1.52 mm (limit 1.50 mm)"),
        (Reason.TOO_SOFT, 3.98, 4.0, "N", "too soft: 3.98 N (needs 4.00 N)"),
        (Reason.READINGS_LOST, 0.064, 0.061, "s", "readings lost: 0.064 s (limit 0.061 s)"),
        (Reason.TOO_MANY_TAXELS, 7.0, 6.0, "", "too many taxels answered: 7 (limit 6)"),
    ],
)
def test_a_value_reads_otherwise_than_its_limit(reason, value, limit, unit, words):
    rejection = Rejection(1, 0.0, 1.0, reason, value, limit, unit, np.zeros(0, dtype=np.int64), final=True, pose=TOOL_ARM_POSE)
    assert rejection_words(rejection) == words

import math

import numpy as np
import pytest

from skincal.contacts.outcome import Contact, Reason, Rejection
from skincal.contacts.thresholds import NEWEST_POKES_COMPARED, threshold_uses


def contact(poke, size=8.0, pitch_m=0.002, taxels=2, tare_change=math.nan):
    force = np.array([0.0, 0.0, -size])
    channels = np.arange(taxels)
    return Contact(poke, 0.0, 0.3, force, pitch_m * force, channels, 10.0 + channels, np.eye(4), "", tare_change, True)


def rejection(poke, reason, value, limit, unit, force=None):
    moment = None if force is None else np.zeros(3)
    return Rejection(poke, 0.0, 0.3, reason, value, limit, unit, np.array([1]), True, force, moment)


def test_values_and_rejections_of_the_newest_pokes():
    pokes = [contact(1), contact(2, size=6.0, pitch_m=-0.004, taxels=3, tare_change=0.3)]
    pokes += [rejection(3, Reason.TWO_CONTACTS, 0.012, 0.008, "m", np.array([0.0, 5.0, 0.0]))]
    pokes += [rejection(4, Reason.NOT_STILL, 0.1, 0.3, "s"), rejection(5, Reason.NOT_STILL, 0.08, 0.05, "1")]
    # A force of nothing has no pitch, and the distance of far taxels is no factor.
    pokes += [rejection(6, Reason.SLID, 0.003, 0.0015, "m", np.zeros(3)), rejection(7, Reason.NOT_CONNECTED, 0.02, 0.01, "m")]
    wanted = {
        "force_max": (8.0, 6.0, 5.0),
        "pitch_max": (0.002, 0.004, 0.012),
        "taxels_max": (2.0, 3.0),
        "still_s": (0.1,),
        "still_change": (0.08,),
        "slide_max": (0.003,),
        "tare_change_max": (0.3,),
        "response_min": (11.0, 12.0),
        "gap_factor": (),
        "quiet_s": (),
    }
    uses = threshold_uses(pokes, tuple(wanted))
    assert {name: use.values for name, use in uses.items()} == {name: pytest.approx(values) for name, values in wanted.items()}
    rejecting = {name for name, use in uses.items() if use.rejected}
    assert rejecting == {"pitch_max", "still_s", "still_change", "slide_max", "gap_factor"}
    assert {use.pokes for use in uses.values()} == {7}


def test_only_the_newest_are_compared():
    old = [rejection(poke, Reason.SLID, 0.003, 0.0015, "m") for poke in range(1, 4)]
    newest = [contact(poke) for poke in range(4, 4 + NEWEST_POKES_COMPARED)]
    assert threshold_uses([*old, *newest], ("slide_max",))["slide_max"].rejected == 0
    assert threshold_uses([*old, *newest[:-1]], ("slide_max",))["slide_max"].rejected == 1
    assert threshold_uses((), ("slide_max",))["slide_max"].pokes == 0


@pytest.mark.parametrize(
    ("reason", "unit", "name"),
    [
        (Reason.TOO_SOFT, "N", "force_min"),
        (Reason.NOT_CONNECTED, "m", "gap_factor"),
        (Reason.NO_TAXEL, "raw", "response_min"),
        (Reason.NOT_STILL, "s", "still_s"),
        (Reason.READINGS_LOST, "s", ""),
        (Reason.NO_TARE, "s", ""),
    ],
)
def test_a_rejection_names_its_threshold(reason, unit, name):
    assert rejection(1, reason, 1.0, 2.0, unit).threshold == name

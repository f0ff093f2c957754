import math
from dataclasses import replace

import numpy as np
import pytest

from skincal.contacts.outcome import Contact, Reason, Rejection
from skincal.contacts.thresholds import NEWEST_POKES, rejected_by, threshold_uses


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
    names = ("force_max", "pitch_max", "taxels_max", "still_s", "still_change", "tare_change_max", "response_min", "quiet_s")
    uses = threshold_uses(pokes, names)
    assert uses["force_max"].values == (8.0, 6.0, 5.0)
    assert uses["pitch_max"].values == pytest.approx((0.002, 0.004, 0.012))
    assert uses["taxels_max"].values == (2.0, 3.0)
    assert uses["still_s"].values == (0.1,)
    assert uses["still_change"].values == (0.08,)
    assert uses["tare_change_max"].values == (0.3,)
    assert uses["response_min"].values == (11.0, 12.0)
    assert uses["quiet_s"].values == ()
    assert {name: use.rejected for name, use in uses.items() if use.rejected} == {
        "pitch_max": 1, "still_s": 1, "still_change": 1
    }  # fmt: skip
    assert {use.pokes for use in uses.values()} == {5}


def test_only_the_newest_are_looked_at():
    old = [rejection(poke, Reason.SLID, 0.003, 0.0015, "m") for poke in range(1, 4)]
    newest = [contact(poke) for poke in range(4, 4 + NEWEST_POKES)]
    assert threshold_uses([*old, *newest], ("slide_max",))["slide_max"].rejected == 0
    assert threshold_uses([*old, *newest[:-1]], ("slide_max",))["slide_max"].rejected == 1
    assert threshold_uses((), ("slide_max",))["slide_max"].pokes == 0


@pytest.mark.parametrize(
    ("reason", "unit", "name"),
    [
        (Reason.TOO_SOFT, "N", "force_min"),
        (Reason.NOT_CONNECTED, "m", "gap_factor"),
        (Reason.NO_TAXEL, "raw", "response_min"),
        (Reason.READINGS_LOST, "s", ""),
        (Reason.NO_TARE, "s", ""),
    ],
)
def test_what_rejected_a_poke(reason, unit, name):
    assert rejected_by(rejection(1, reason, 1.0, 2.0, unit)) == name
    assert rejected_by(contact(1)) == ""


def test_taxels_far_apart_are_counted_and_their_lengths_are_no_factor():
    use = threshold_uses([rejection(1, Reason.NOT_CONNECTED, 0.02, 0.01, "m")], ("gap_factor",))["gap_factor"]
    assert (use.rejected, use.values) == (1, ())


def test_a_force_of_nothing_has_no_pitch():
    nothing = replace(rejection(1, Reason.SLID, 0.003, 0.0015, "m", np.zeros(3)))
    assert threshold_uses([nothing], ("pitch_max", "force_min"))["pitch_max"].values == ()

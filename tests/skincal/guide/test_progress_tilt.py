"""The most that a push may lean: learnt from pokes that slid and from what the hand manages."""

import numpy as np
import pytest

from skincal.guide.progress import ANGLES, HITS, LEAST, MARGIN, PRIOR, SLIDES, STEP, GuideSettings, Tilt

SETTINGS = GuideSettings()


def degrees(*angles):
    return np.radians(np.array(angles, dtype=float))


def fresh():
    return Tilt(SETTINGS)


def test_before_any_poke_the_usual_tilt_is_usable():
    assert fresh().usable == SETTINGS.usable_tilt


@pytest.mark.parametrize("angle", [18.0, 24.0, 45.0])
def test_the_friction_angle_is_found_from_pokes_that_slide_beyond_it(angle):
    tilt, rng = fresh(), np.random.default_rng(1)
    for made in np.degrees(SETTINGS.usable_tilt) + 6.0 * rng.standard_normal(80):
        slides = rng.uniform() < (0.8 if made > angle else 0.03)
        tilt.poked(degrees(made), slid=slides)
    assert np.degrees(tilt.friction) == pytest.approx(angle, abs=4.0) or angle > 40.0
    expected = min(np.radians(angle) - MARGIN, SETTINGS.usable_tilt)
    assert tilt.usable == pytest.approx(expected, abs=np.radians(5.0))


def test_friction_is_bayes_rule():
    tilt = fresh()
    tilt.poked(degrees(20.0, 33.0), slid=False)
    tilt.poked(degrees(31.0), slid=True)
    mean, sd = PRIOR
    likely = np.exp(-0.5 * ((ANGLES - mean) / sd) ** 2)
    for made, slid in ((20.0, False), (33.0, False), (31.0, True)):
        more = np.where(np.radians(made) > ANGLES, SLIDES[1], SLIDES[0])
        likely *= more if slid else 1.0 - more
    share = likely.cumsum() / likely.sum()
    assert tilt.friction == pytest.approx(ANGLES[np.flatnonzero(share >= 0.5)[0]])


def test_one_slide_changes_nothing_and_what_is_taken_out_leaves_no_trace():
    tilt = fresh()
    tilt.poked(degrees(28.0), slid=True)
    assert tilt.usable == SETTINGS.usable_tilt
    tilt.poked(degrees(27.0, 28.0, 29.0), slid=True)
    less = tilt.usable
    assert less < SETTINGS.usable_tilt
    assert less % STEP == pytest.approx(0.0, abs=1e-9) or less % STEP == pytest.approx(STEP, abs=1e-9)
    tilt.poked(degrees(27.0, 28.0, 29.0), slid=True, taken_out=True)
    assert tilt.usable == SETTINGS.usable_tilt


def test_a_tilt_that_is_not_known_says_nothing():
    tilt, other = fresh(), fresh()
    tilt.poked(np.array([np.nan, np.radians(35.0)]), slid=False)
    other.poked(degrees(35.0), slid=False)
    assert tilt.friction == other.friction


def test_two_misses_in_a_row_lower_what_is_asked_for_and_hits_raise_it():
    tilt, asked = fresh(), SETTINGS.usable_tilt
    tilt.aimed(asked, np.radians(12.0))
    assert tilt.usable == asked, "once is no habit"
    tilt.aimed(asked, asked)
    tilt.aimed(asked, np.radians(12.0))
    assert tilt.usable == asked, "not in a row"
    tilt.aimed(asked, np.radians(14.0))
    lowered = tilt.usable
    assert np.radians(13.0) < lowered < asked
    for _ in range(HITS):
        tilt.aimed(lowered, lowered)
    assert lowered < tilt.usable < asked
    for _ in range(20 * HITS):
        tilt.aimed(tilt.usable, tilt.usable)
    assert tilt.usable == asked


def test_a_hand_that_cannot_tilt_at_all_is_asked_for_little_and_not_nagged():
    tilt = fresh()
    for _ in range(20):
        tilt.aimed(tilt.usable, 0.0)
    assert tilt.usable == pytest.approx(LEAST)


def test_a_straight_poke_is_never_missed():
    tilt = fresh()
    for _ in range(5):
        tilt.aimed(0.0, 0.0)
    assert tilt.usable == SETTINGS.usable_tilt

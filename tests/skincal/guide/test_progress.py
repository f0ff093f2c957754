"""Needs of a taxel, reasons to give it up, pokes left, turns, and the largest usable tilt."""

from dataclasses import replace
from itertools import accumulate

import numpy as np
import pytest

from skincal.guide.candidates import next_module_taxel, next_taxel
from skincal.guide.progress import (
    MAX_WORKING_POKE_INTERVAL_S,
    ContactFacts,
    GuideSettings,
    Need,
    Why,
    count_pokes_from_start,
    count_pokes_left,
    find_needs,
    give_up_reason,
    improvable_error,
    poke_interval,
    working_time,
)
from skincal.guide.taxel_statistics import TaxelStatistics
from skincal.guide.tilt_limit import (
    FRICTION_ANGLES_RAD,
    FRICTION_PRIOR_RAD,
    HITS_IN_A_ROW_TO_RAISE_LIMIT,
    MIN_TILT_RAD,
    SLIDE_PROBABILITIES,
    TILT_MARGIN_RAD,
    TILT_STEP_RAD,
    TiltLimit,
)
from skincal.model.scene import NoiseSettings
from skincal.taxels.result import Cause, Estimate, Method, State, StateReason

SETTINGS = GuideSettings()
SKIN = 0.0015


# ---- needs ----


@pytest.mark.parametrize(
    ("changes", "rms", "need"),
    [
        ({}, 0.002, None),
        ({"own": 2}, 0.002, Need.POKES),
        ({}, 0.0031, Need.ACCURACY),
        ({"diversity": np.radians(14)}, 0.002, Need.SIDES),
        ({"offset": 0.0011}, 0.002, Need.BALANCE),
        ({"depth_bias": 0.0011}, 0.002, Need.DEPTH),
        ({"depth_bias": -0.0011}, 0.002, Need.DEPTH),
        ({"last_shift": 0.0006}, 0.002, Need.SETTLED),
        ({"last_shift": np.inf}, 0.002, Need.SETTLED),
    ],
)
def test_a_taxel_is_finished_when_nothing_is_missing(changes, rms, need):
    facts = replace(ContactFacts(own=3, diversity=np.radians(20), last_shift=0.0), **changes)
    one = Estimate(0, Method.FREE, State.TOUCHED, 3, rms=rms)
    assert find_needs(one, facts, Method.FREE, SETTINGS, SKIN) == (() if need is None else (need,))
    on_surface = find_needs(one, facts, Method.SURFACE, SETTINGS, SKIN)
    assert on_surface == (() if need in (None, Need.SIDES, Need.DEPTH) else (need,))


def test_a_dead_taxel_needs_nothing_and_an_unseen_one_does():
    dead = Estimate(0, Method.FREE, State.DEAD, 0, reason=StateReason(Cause.EXTERNAL_TEXT, text="stuck"))
    assert find_needs(dead, ContactFacts(0), Method.FREE, SETTINGS, SKIN) == ()
    unseen = find_needs(Estimate(0, Method.FREE, State.UNSEEN, 0), ContactFacts(0), Method.FREE, SETTINGS, SKIN)
    assert {Need.POKES, Need.ACCURACY, Need.SIDES} <= set(unseen)


@pytest.mark.parametrize("moved", [None, np.diag([0.4e-3, 0.0, 0.6e-3]), np.array([[0.0], [0.3e-3], [2e-3]])])
@pytest.mark.parametrize(
    ("own", "triangle", "skin", "expected"),
    [
        ((1.1e-3, 1.0e-3, 0.7e-3), None, 0.0, (1.1e-3, 1.0e-3, 0.7e-3)),
        ((1.1e-3, 1.0e-3, 0.7e-3), 5, SKIN, (1.1e-3, 1.0e-3)),
        ((0.5e-3, 0.4e-3, 2.0e-3), None, SKIN, (0.5e-3, 0.4e-3, np.sqrt(4e-6 - SKIN**2))),
        ((0.5e-3, 0.4e-3, 2.0e-3), None, 0.003, (0.5e-3, 0.4e-3)),
    ],
    ids=["no mesh, thin skin", "mesh", "skin of 1.5 mm", "thick skin"],
)
def test_shared_errors_and_those_of_the_mesh_or_the_thickness_are_not_improvable(moved, own, triangle, skin, expected):
    shared = np.zeros((3, 3)) if moved is None else moved @ moved.T
    covariance = np.diag(np.square(own)) + shared
    estimate = Estimate(
        3, Method.MODULES, State.TOUCHED, 9, normal=np.array([0.0, 0.0, 1.0]), covariance=covariance,
        rms=float(np.sqrt(np.trace(covariance))), triangle=triangle, moved=moved,
    )  # fmt: skip
    assert improvable_error(estimate, skin) == pytest.approx(np.linalg.norm(expected))
    assert improvable_error(Estimate(3, Method.MODULES, State.UNSEEN, 0), skin) == float("inf")


@pytest.mark.parametrize(
    ("missing", "changes", "why"),
    [
        ((Need.SETTLED,), {}, None),
        ((), {"own": 99}, None),
        ((Need.SETTLED,), {"patience_exhausted": True}, Why.NOT_CONVERGED),
        ((Need.DECISION,), {"patience_exhausted": True}, Why.AMBIGUOUS),
        ((Need.POKES,), {"own": 0, "contacts": 0, "unanswered": SETTINGS.unanswered}, Why.NEVER_FIRED),
        ((Need.POKES,), {"own": 0, "contacts": 1, "unanswered": SETTINGS.unanswered}, None),
        ((Need.POKES,), {"own": 0, "contacts": 0, "unanswered": SETTINGS.unanswered - 1}, None),
        ((Need.POKES,), {"own": 0, "contacts": 0, "all_sides_skipped": True}, Why.OUT_OF_REACH),
        ((Need.SIDES,), {"tilt": np.radians(12.0)}, Why.TILT),
        ((Need.SIDES, Need.ACCURACY), {"tilt": np.radians(12.0)}, Why.TILT),
        ((Need.ACCURACY,), {"tilt": np.radians(12.0)}, None),
        ((Need.SIDES,), {"tilt": np.radians(12.0), "own": SETTINGS.own_pokes - 1}, None),
    ],
)
def test_a_taxel_is_given_up_only_if_more_pokes_would_not_help(missing, changes, why):
    facts = {"own": 5, "contacts": 9, "unanswered": 0}
    usual = {**facts, "patience_exhausted": False, "all_sides_skipped": False, "tilt": SETTINGS.usable_tilt, **changes}
    pokes = ContactFacts(**{name: usual.pop(name) for name in facts})
    assert give_up_reason(missing, pokes, SETTINGS, **usual) is why


# ---- pokes left ----


def test_fewer_pokes_are_left_the_more_is_known():
    def left(own, rms=0.002, offset=0.0, shift=0.0, is_open=True):
        know = TaxelStatistics(np.array([0]), NoiseSettings(), SETTINGS.unknown, in_plane=False)
        know.own[0], know.offset[0, 0], know.last_shift[0] = own, offset, shift
        return count_pokes_left(Method.FREE, np.array([is_open]), know, np.array([rms]), SETTINGS)

    assert left(0, np.inf, 0.0, np.inf, is_open=False) == 0
    falling = [left(0, np.inf, 0.0, np.inf), left(2, 0.004, 0.0, 0.001), left(5, 0.002, 0.0, 0.001)]
    assert falling == sorted(falling, reverse=True)
    assert falling[-1] >= 1
    assert left(5, 0.006) > left(5, 0.002)
    assert left(5, offset=0.002) > left(5)
    assert left(SETTINGS.patience - 1, 0.02) <= 2, "no taxel gets more than the guide has patience for"


@pytest.mark.parametrize(("method", "took"), [(Method.FREE, 820), (Method.SURFACE, 650)])
def test_a_method_s_pokes_are_predicted_to_a_third(method, took):
    """Of the standard study, seven modules of twelve taxels."""
    predicted = count_pokes_from_start(method, np.repeat(np.arange(7), 12), SETTINGS, on_mesh=True)
    assert predicted == pytest.approx(took, rel=1 / 3)


def test_interval_and_working_time_leave_out_pauses():
    times = np.array(list(accumulate([0.0, 3.0, 3.0, MAX_WORKING_POKE_INTERVAL_S + 1.0, 4.0, 3.0])))
    assert poke_interval(times) == pytest.approx(3.0)
    assert poke_interval(times[:2]) is None
    assert working_time(times, times + 0.5) == pytest.approx(6 * 0.5 + 2.5 + 2.5 + 3.5 + 2.5)
    assert working_time(np.empty(0), np.empty(0)) == 0.0


# ---- turns ----

LINE = np.arange(6)[:, None] * [0.005, 0.0, 0.0]


def asked_for(modules, turns, answers=None, rows=None, seconds=None):
    """Poke `turns` times the next taxel; one of `answers` is answered by that one, None by none."""
    count = len(modules)
    asked, own = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
    rows, found = np.arange(count) if rows is None else np.array(rows), []
    for _ in range(turns):
        row = next_module_taxel(rows, np.ones(len(rows)) if seconds is None else seconds, asked, own, np.array(modules), LINE)
        found.append(row)
        asked[row] += 1
        if (hit := (answers or {}).get(row, row)) is not None:
            own[hit] += 1
    return found


def test_modules_take_turns_and_each_poke_is_far_from_those_before():
    assert asked_for([0, 0, 0, 1, 1, 1], 6) == [0, 3, 2, 5, 1, 4]
    assert asked_for([0, 0, 0, 1, 1, 1], 1, seconds=np.array([3.0, 3.0, 3.0, 2.0, 1.0, 2.0])) == [4], "the soonest reached"
    for rows in ([0, 1], [0, 2, 5], [0, 1, 2, 3, 4, 5]):
        assert np.bincount(asked_for([0] * 6, 4 * len(rows), rows=rows), minlength=6)[rows].tolist() == [4] * len(rows)


def test_a_missed_taxel_is_asked_for_twice_and_a_silent_module_keeps_no_other_waiting():
    found = asked_for([0] * 6, 6, answers={5: 2})
    assert (found[:3], found.count(5)) == ([0, 5, 5], 2)
    found = asked_for([0, 0, 0, 1, 1, 1], 12, answers={0: None, 1: None, 2: None})
    assert np.bincount(np.array(found) // 3).tolist() == [7, 5]
    assert found.count(0) <= 3


def test_a_poked_taxel_without_a_position_does_not_hide_the_others():
    places, none = LINE.copy(), np.zeros(6, dtype=np.int64)
    places[5] = np.nan
    own = np.array([1, 0, 0, 0, 0, 1])
    assert next_module_taxel(np.arange(5), np.ones(5), none, own, none, places) == 4
    assert next_module_taxel(np.array([2, 3]), np.array([2.0, 1.0]), none, own, none, np.full((6, 3), np.nan)) == 3


def test_taxels_take_turns():
    asked, own = np.array([1, 2, 0, 3, 0, 0]), np.array([1, 0, 1, 0, 0, 1])
    seconds = np.array([1.0, 1.0, 1.0, 1.0, 9.0, 1.0])
    assert next_taxel(np.arange(6), seconds, asked, own) == 4, "the only one without a poke"
    # 1 was missed twice and is due again in this round; 3 was missed three times and waits for the next.
    assert next_taxel(np.array([0, 1, 3]), np.array([3.0, 2.0, 1.0]), asked, own) == 1


# ---- tilt ----


def degrees(*angles):
    return np.radians(np.array(angles, dtype=float))


@pytest.mark.parametrize("angle", [18.0, 24.0, 45.0])
def test_the_friction_angle_is_found_from_pokes_that_slide_beyond_it(angle):
    tilt, rng = TiltLimit(SETTINGS), np.random.default_rng(1)
    assert tilt.usable == SETTINGS.usable_tilt
    for made in np.degrees(SETTINGS.usable_tilt) + 6.0 * rng.standard_normal(80):
        tilt.add_pokes(degrees(made), slid=rng.uniform() < (0.8 if made > angle else 0.03))
    assert np.degrees(tilt.friction) == pytest.approx(angle, abs=4.0) or angle > 40.0
    expected = min(np.radians(angle) - TILT_MARGIN_RAD, SETTINGS.usable_tilt)
    assert tilt.usable == pytest.approx(expected, abs=np.radians(5.0))


def test_friction_is_bayes_rule_and_an_unknown_tilt_says_nothing():
    tilt = TiltLimit(SETTINGS)
    tilt.add_pokes(np.append(degrees(20.0, 33.0), np.nan), slid=False)
    tilt.add_pokes(degrees(31.0), slid=True)
    mean, sd = FRICTION_PRIOR_RAD
    likely = np.exp(-0.5 * ((FRICTION_ANGLES_RAD - mean) / sd) ** 2)
    for made, slid in ((20.0, False), (33.0, False), (31.0, True)):
        more = np.where(np.radians(made) > FRICTION_ANGLES_RAD, SLIDE_PROBABILITIES[1], SLIDE_PROBABILITIES[0])
        likely *= more if slid else 1.0 - more
    share = likely.cumsum() / likely.sum()
    assert tilt.friction == pytest.approx(FRICTION_ANGLES_RAD[np.flatnonzero(share >= 0.5)[0]])


def test_one_slide_changes_nothing_and_removed_pokes_leave_no_trace():
    tilt = TiltLimit(SETTINGS)
    tilt.add_pokes(degrees(28.0), slid=True)
    assert tilt.usable == SETTINGS.usable_tilt
    tilt.add_pokes(degrees(27.0, 28.0, 29.0), slid=True)
    assert tilt.usable < SETTINGS.usable_tilt
    assert tilt.usable / TILT_STEP_RAD == pytest.approx(round(tilt.usable / TILT_STEP_RAD))
    tilt.add_pokes(degrees(27.0, 28.0, 29.0), slid=True, remove=True)
    assert tilt.usable == SETTINGS.usable_tilt


def test_two_misses_in_a_row_lower_the_limit_and_hits_raise_it():
    tilt, asked = TiltLimit(SETTINGS), SETTINGS.usable_tilt
    for made in (np.radians(12.0), asked, np.radians(12.0)):
        tilt.compare_aim(asked, made)
        assert tilt.usable == asked, "not twice in a row"
    tilt.compare_aim(asked, np.radians(14.0))
    lowered = tilt.usable
    assert np.radians(13.0) < lowered < asked
    for _ in range(HITS_IN_A_ROW_TO_RAISE_LIMIT):
        tilt.compare_aim(lowered, lowered)
    assert lowered < tilt.usable < asked
    for _ in range(20 * HITS_IN_A_ROW_TO_RAISE_LIMIT):
        tilt.compare_aim(tilt.usable, tilt.usable)
    assert tilt.usable == asked


@pytest.mark.parametrize(("asked", "made", "usable"), [(None, 0.0, MIN_TILT_RAD), (0.0, 0.0, SETTINGS.usable_tilt)])
def test_a_hand_that_cannot_tilt_is_asked_for_little_and_a_straight_target_is_never_missed(asked, made, usable):
    tilt = TiltLimit(SETTINGS)
    for _ in range(20):
        tilt.compare_aim(tilt.usable if asked is None else asked, made)
    assert tilt.usable == pytest.approx(usable)

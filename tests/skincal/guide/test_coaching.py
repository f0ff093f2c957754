"""The coach against pokes whose tip and tool are known: their wrench is all it gets."""

from __future__ import annotations

import numpy as np
import pytest

from skincal.contacts.outcome import PressPhase, Progress
from skincal.geometry import axis_point, move_wrench
from skincal.guide.guidance import Target
from skincal.guide.press_coaching import (
    LOW_PASS_OLD_VALUE_WEIGHT,
    MIN_FORCE_FOR_TILT_N,
    PokeError,
    compare_to_target,
    smooth_wrench,
)

SOME_WAY = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
"""A rotation."""


def tool(tilt: float, azimuth: float) -> np.ndarray:
    """The push of a tool on a skin with the normal z, its upper end leaning to `azimuth`; degrees."""
    tilt, azimuth = np.radians([tilt, azimuth])
    return -np.array([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)])


def asked(push, place=(0.0, 0.0, 0.0), turn=None) -> Target:
    turn = np.eye(3) if turn is None else turn
    place, normal = turn @ np.array(place), turn[:, 2]
    return Target(7, place, normal, turn @ push, float(np.arccos(-push[2])), 0.01, 0.005)


def pressing(tip, push, newtons=8.0, turn=None, channels=(7,), responses=(60.0,), phase=PressPhase.PRESSING) -> Progress:
    """What the sensor says of a tip that pushes: wrench in a frame of its own, carried into the link frame."""
    turn = np.eye(3) if turn is None else turn
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = SOME_WAY, (0.01, -0.18, 0.05)
    force, point = turn @ push * newtons, turn @ np.array(tip, dtype=float)
    at = SOME_WAY.T @ (point - pose[:3, 3])
    f_s = SOME_WAY.T @ force
    force, moment = move_wrench(pose, f_s, np.cross(at, f_s))
    k, t = np.array(channels, dtype=np.int64), np.array(responses, dtype=float)
    return Progress(phase, force, axis_point(force, moment), k, t, 0.0)


def seen_of(progress: Progress, target: Target, skin) -> PokeError | None:
    """What the coach says of the first reading."""
    felt = smooth_wrench(None, progress)
    return None if felt is None else compare_to_target(felt, progress, target, skin)


@pytest.mark.parametrize("turn", [np.eye(3), SOME_WAY])
@pytest.mark.parametrize(("tilt", "azimuth"), [(0.0, 0.0), (28.0, 40.0), (45.0, -100.0)])
def test_tip_and_tilt_come_out_as_they_were(turn, tilt, azimuth):
    target = asked(tool(28.0, 40.0), (0.02, 0.01, 0.0), turn)
    tip = np.array([0.023, 0.006, 0.0])
    seen = seen_of(pressing(tip, tool(tilt, azimuth), turn=turn), target, target.place)
    assert seen is not None
    np.testing.assert_allclose(turn.T @ seen.contact, tip, atol=1e-12)
    np.testing.assert_allclose(turn.T @ seen.off, [-0.003, 0.004, 0.0], atol=1e-12)
    assert seen.away == pytest.approx(0.005)
    np.testing.assert_allclose(turn.T @ seen.push, tool(tilt, azimuth), atol=1e-12)
    assert np.degrees(seen.tilt) == pytest.approx(tilt, abs=1e-5)
    cosine = tool(tilt, azimuth) @ tool(28.0, 40.0)
    assert np.cos(seen.error) == pytest.approx(cosine)
    assert seen.landed == 7


@pytest.mark.parametrize(
    ("wanted", "held", "error", "towards"),
    [
        ((28.0, 0.0), (20.0, 0.0), 8.0, (1.0, 0.0)),
        ((28.0, 0.0), (36.0, 0.0), 8.0, (-1.0, 0.0)),
        ((0.0, 0.0), (12.0, 90.0), 12.0, (0.0, -1.0)),
        ((28.0, 90.0), (0.0, 0.0), 28.0, (0.0, 1.0)),
        ((28.0, 0.0), (28.0, 180.0), 56.0, (1.0, 0.0)),
    ],
)
def test_the_way_to_the_wanted_tilt_is_where_the_upper_end_has_to_go(wanted, held, error, towards):
    target = asked(tool(*wanted))
    seen = seen_of(pressing((0, 0, 0), tool(*held)), target, target.place)
    assert seen is not None
    assert np.degrees(seen.error) == pytest.approx(error)
    np.testing.assert_allclose(seen.lean, [*towards, 0.0], atol=1e-9)
    # Half the way in that direction is nearer.
    mean = tool(*held) / 2 + tool(*wanted) / 2
    better = seen_of(pressing((0, 0, 0), mean / np.linalg.norm(mean)), target, target.place)
    assert better is not None
    assert better.error < 0.6 * seen.error


def test_a_push_as_it_was_asked_for_has_no_error_and_no_way():
    target = asked(tool(28.0, 40.0))
    seen = seen_of(pressing((0, 0, 0), tool(28.0, 40.0)), target, target.place)
    assert seen is not None
    assert seen.error < 1e-9
    np.testing.assert_array_equal(seen.lean, np.zeros(3))
    assert seen.away < 1e-12


def test_the_tip_is_found_on_the_skin_where_the_believed_place_lies_too_deep():
    # A tool that leans by 45 degrees meets a place 4 mm below the skin 4 mm beside the tip.
    target = asked(tool(45.0, 0.0), (0.0, 0.0, -0.004))
    right = seen_of(pressing((0, 0, 0), tool(45.0, 0.0)), target, np.zeros(3))
    wrong = seen_of(pressing((0, 0, 0), tool(45.0, 0.0)), target, target.place)
    assert right is not None
    assert wrong is not None
    assert right.away < 1e-12
    assert wrong.away == pytest.approx(0.004)


def test_the_poke_landed_where_the_taxel_that_answers_most_is():
    target = asked(tool(0.0, 0.0))
    seen = seen_of(pressing((0, 0, 0), tool(0, 0), channels=(3, 7, 9), responses=(12.0, 30.0, 55.0)), target, np.zeros(3))
    assert seen is not None
    assert seen.landed == 9
    none = seen_of(pressing((0, 0, 0), tool(0, 0), channels=(), responses=()), target, np.zeros(3))
    assert none is not None
    assert none.landed is None


@pytest.mark.parametrize("phase", [PressPhase.NO_DATA, PressPhase.TARING, PressPhase.READY])
def test_nothing_is_said_while_nothing_presses(phase):
    target = asked(tool(0.0, 0.0))
    assert seen_of(pressing((0, 0, 0), tool(0, 0), phase=phase), target, np.zeros(3)) is None


@pytest.mark.parametrize(
    "progress",
    [
        pressing((0, 0, 0), tool(0, 0), newtons=0.95 * MIN_FORCE_FOR_TILT_N),
        Progress(PressPhase.PRESSING, np.zeros(3), np.zeros(3), np.empty(0, np.int64), np.empty(0), 0.0),
        Progress(PressPhase.PRESSING, np.full(3, np.nan), np.full(3, np.nan), np.empty(0, np.int64), np.empty(0), 0.0),
        pressing((0, 0, 0), tool(80.0, 0.0)),
        pressing((0, 0, 0), -tool(10.0, 0.0)),
    ],
    ids=["too soft to know", "no force", "no number", "along the skin", "pulls"],
)
def test_nothing_is_said_of_what_cannot_be_known(progress):
    assert seen_of(progress, asked(tool(0.0, 0.0)), np.zeros(3)) is None


def test_noise_of_the_sensor_moves_the_coach_by_no_more_than_the_hand_errs():
    """Noise of 0.1 N and 10 N mm in every reading: at 4 N the tilt is known to a degree, the tip to 2 mm (sd each way)."""
    rng = np.random.default_rng(5)
    target, skin, felt = asked(tool(28.0, 0.0)), np.zeros(3), None
    errors, aways = [], []
    for _ in range(1500):
        one = pressing((0, 0, 0), tool(28.0, 0.0), newtons=4.0)
        force = one.force + rng.normal(0.0, 0.1, 3)
        moment = np.cross(one.axis_point, one.force) + rng.normal(0.0, 0.01, 3)
        noisy = Progress(one.phase, force, axis_point(force, moment), one.channels, one.responses, 0.0)
        felt = smooth_wrench(felt, noisy)
        assert felt is not None
        seen = compare_to_target(felt, noisy, target, skin)
        assert seen is not None
        errors.append(seen.error)
        aways.append(seen.away)
    assert np.degrees(np.sqrt(np.mean(np.square(errors)) / 2.0)) < 1.0
    assert np.sqrt(np.mean(np.square(aways)) / 2.0) < 0.002


def test_what_is_felt_follows_within_a_few_readings_and_a_weak_force_counts_little():
    felt = smooth_wrench(None, pressing((0.004, 0, 0), tool(0, 0), newtons=1.0))
    strong = pressing((0, 0, 0), tool(0, 0), newtons=9.0)
    target = asked(tool(0, 0))
    for reading in range(1, 6):
        felt = smooth_wrench(felt, strong)
        assert felt is not None
        seen = compare_to_target(felt, strong, target, np.zeros(3))
        assert seen is not None
        weak = LOW_PASS_OLD_VALUE_WEIGHT**reading
        assert seen.away == pytest.approx(0.004 * weak / (weak + 9.0 * (1.0 - weak)))
    assert smooth_wrench(felt, pressing((0, 0, 0), tool(0, 0), phase=PressPhase.TARING)) is None, "the next poke begins anew"

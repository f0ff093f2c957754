"""The frame of each taxel: by its own pokes or its module's, or the reason why it has none."""

import numpy as np
import pytest

from skincal.axes.module_axes import SIGNED_PERMUTATIONS, ModulePlan, describe_permutation, find_axes
from skincal.axes.session_turns import SessionTurns
from skincal.axes.skin_turns import find_turns, fit_group, joined
from skincal.axes.taxel_frames import FrameState, frames_of_taxels
from skincal.geometry import rotation_by
from tests.skincal.axes.axis_support import FORCE_NOISE_N, NOISE, make_pokes, random_rotation, turn_between

POKED, CHANNELS = (0, 1, 2, 3, 4), range(7)
"""Taxels with pokes; taxel 5 of the module has none, and taxel 6 is of no module."""
MIRROR = np.diag([1.0, -1.0, 1.0])


def frames(lean=15.0, *, own_axes=False, change=None, pokes=8):
    rng = np.random.default_rng(3)
    plan = random_rotation(rng)
    shared = plan @ rotation_by(np.radians(2.0) * rng.normal(size=3))
    true, made = {}, {}
    for channel in POKED:
        true[channel] = shared @ rotation_by(np.array([0.0, 0.0, rng.uniform(-3, 3)])) if own_axes else shared
        own = make_pokes(rng, true[channel], pokes, lean)
        readings = own.readings if change is None else own.readings @ change.T
        made[channel] = type(own)(own.forces, readings, own.pokes + 100 * channel)
    turns = find_turns(made, FORCE_NOISE_N)
    found = find_axes(turns, [ModulePlan(1, (*POKED, 5), plan)])
    session = SessionTurns(turns, {module.id: module for module in found.modules}, dict.fromkeys((*POKED, 5), 1))
    return frames_of_taxels(session, found, CHANNELS), true, turns


def test_taxels_that_share_their_axes_have_the_frame_of_the_module_also_without_a_poke():
    found, true, turns = frames()
    assert [found[channel].state for channel in CHANNELS] == [FrameState.BY_MODULE] * 6 + [FrameState.UNKNOWN]
    for channel in range(6):
        off = turn_between(found[channel].rotation, true[0])
        assert np.degrees(np.linalg.norm(off)) < 1.5
        np.testing.assert_array_equal(found[channel].rotation, found[0].rotation)
    # All pokes of the module say more than those of one taxel.
    assert found[0].in_plane_sd < turns.taxels[0].fit.in_plane_sd
    assert found[0].normal_sd < np.radians(1.0)
    assert (found[0].pokes, found[5].pokes, found[6].rotation) == (8, 0, None)


def test_the_error_by_a_module_contains_the_scatter_of_its_taxels():
    """Taxels lie in a shared housing to 1.5 degrees: z of each is as far from that of the module."""
    rng, plan, sd = np.random.default_rng(6), random_rotation(np.random.default_rng(7)), np.radians(1.5)
    true = {k: plan @ rotation_by(np.append(sd * rng.normal(size=2), 0.0)) for k in range(12)}
    made = {k: make_pokes(rng, axes, 3, 15.0) for k, axes in true.items()}
    made = {k: type(own)(own.forces, own.readings, own.pokes + 100 * k) for k, own in made.items()}
    turns = find_turns(made, FORCE_NOISE_N)
    found = find_axes(turns, [ModulePlan(1, tuple(true), plan)])
    session = SessionTurns(turns, {1: found.modules[0]}, dict.fromkeys(true, 1))
    frames_ = frames_of_taxels(session, found, true)
    assert {frame.state for frame in frames_.values()} == {FrameState.BY_MODULE}
    off = np.array([np.arccos(frames_[k].rotation[:, 2] @ axes[:, 2]) for k, axes in true.items()])
    # Taxels with one poke say nothing of the scatter.
    few = {k: type(own)(own.forces[:1], own.readings[:1], own.pokes[:1]) if k > 8 else own for k, own in made.items()}
    spread = find_axes(find_turns(few, FORCE_NOISE_N), [ModulePlan(1, tuple(true), plan)]).modules[0].spread
    assert spread == pytest.approx(np.sqrt(np.mean(off[:9] ** 2)), rel=0.3)
    # Root mean square in each of two directions.
    assert frames_[0].normal_sd == pytest.approx(np.sqrt(np.mean(off**2) / 2.0), rel=0.2)
    assert frames_[0].normal_sd == pytest.approx(session.of_channel(0).normal_sd, rel=1e-9)
    assert frames_[0].in_plane_sd == pytest.approx(session.of_channel(0).in_plane_sd, rel=1e-9)


def test_taxels_with_axes_of_their_own_have_their_own_frames():
    found, true, turns = frames(own_axes=True)
    states = [FrameState.KNOWN] * 5 + [FrameState.UNKNOWN] * 2
    assert [found[channel].state for channel in CHANNELS] == states
    for channel in POKED:
        assert np.degrees(np.linalg.norm(turn_between(found[channel].rotation, true[channel]))) < 6.0
        assert found[channel].in_plane_sd == pytest.approx(turns.taxels[channel].fit.in_plane_sd)


def test_no_turn_is_invented():
    straight, _, _ = frames(0.0)
    assert {straight[channel].state for channel in range(6)} <= {FrameState.IN_PLANE_UNKNOWN, FrameState.UNKNOWN}
    mirrored, _, _ = frames(change=MIRROR)
    assert {mirrored[channel].state for channel in range(6)} == {FrameState.MIRRORED}
    for found in (straight, mirrored):
        assert all(frame.rotation is None and np.isnan(frame.in_plane_sd) for frame in found.values())


def test_left_handed_axes_are_those_with_a_negative_determinant():
    for permutation in SIGNED_PERMUTATIONS:
        assert describe_permutation(permutation, None, 0.0).is_mirrored == (np.linalg.det(permutation) < 0)


def test_readings_of_one_poke_share_its_error():
    """Two taxels that the same pokes press know the turn no better than one."""
    rng = np.random.default_rng(4)
    pokes = make_pokes(rng, random_rotation(rng), 12, 15.0)
    one, both = fit_group((0,), pokes, NOISE), fit_group((0, 1), joined([pokes, pokes]), NOISE)
    np.testing.assert_allclose(both.fit.covariance, one.fit.covariance, rtol=0.15, atol=1e-6)

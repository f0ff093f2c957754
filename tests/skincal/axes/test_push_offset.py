"""Pushes next to the middle of a taxel: the lean of its answers is found, and the turns are right in spite of it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from skincal.axes.push_offset import LEAN_PRIOR_SD, OffsetCorrection, TaxelOffsets, measure_offsets
from skincal.axes.skin_turns import find_turns, fit_group, joined
from skincal.axes.turn_fit import AxisPokes
from skincal.contacts.outcome import Contact
from skincal.geometry import rotation_by
from skincal.taxels.contact_table import ContactTable
from skincal.taxels.result import Estimate, Method, State
from tests.skincal.axes.axis_support import FORCE_NOISE_N, READING_NOISE, make_pokes, random_rotation, turn_between

LEAN = np.radians(2.5) * 1e3
"""rad/m."""
RATIO = 0.6


def pads(seed, taxels=6, count=10, place_noise=0.0, middle_error=0.0, lean=LEAN):
    """Taxels with axes of their own, pushed at places that scatter by 1 mm: pokes, measured offsets, and true axes.

    Each reading is that of the force without its part along the offset, as equation (1) says, written down here.
    """
    rng = np.random.default_rng([5, seed])
    pokes, offsets, true = {}, {}, {}
    for channel in range(taxels):
        axes = random_rotation(rng)
        made = make_pokes(rng, axes, count, 15.0, is_noisy=False)
        along = 1e-3 * rng.normal(size=(count, 2)) @ axes[:, :2].T
        push = -made.forces @ axes[:, 2]
        felt = made.forces - lean * push[:, None] * along
        readings = 0.4 * (felt @ axes) * [RATIO, RATIO, 1.0] + READING_NOISE * rng.normal(size=(count, 3))
        forces = made.forces + FORCE_NOISE_N * rng.normal(size=(count, 3))
        pokes[channel] = AxisPokes(forces, readings, made.pokes + 100 * channel)
        measured = along + (place_noise * rng.normal(size=(count, 2)) - middle_error * rng.normal(size=2)) @ axes[:, :2].T
        offsets[channel] = TaxelOffsets(measured, middle_error**2 * np.eye(3), axes[:, 2])
        true[channel] = axes
    return pokes, offsets, true


def errors(turns, true):
    """Median angle between the z axes, degrees, and the share of turns inside their 95 % regions."""
    angles, squares = [], []
    for channel, turn in turns.taxels.items():
        off = turn_between(turn.fit.rotation, true[channel])
        angles.append(np.degrees(np.arccos(np.clip(turn.fit.rotation[:, 2] @ true[channel][:, 2], -1.0, 1.0))))
        squares.append(off @ np.linalg.solve(turn.fit.covariance[:3, :3], off))
    return float(np.median(angles)), float(np.mean(np.array(squares) < chi2.ppf(0.95, 3)))


def test_the_lean_is_found_and_errors_are_halved():
    pokes, offsets, true = pads(1, taxels=12)
    without = find_turns(pokes, FORCE_NOISE_N)
    found = OffsetCorrection().correct(without, {}, (), offsets)
    assert found.lean.value == pytest.approx(LEAN, abs=4.0 * found.lean.sd)
    assert found.lean.sd < 0.1 * LEAN
    assert errors(found.skin, true)[0] < 0.5 * errors(without, true)[0]
    # The ratio of the gains is not what makes up for it.
    assert np.median([turn.fit.log_ratio for turn in found.skin.taxels.values()]) == pytest.approx(np.log(RATIO), abs=0.06)


@pytest.mark.parametrize(("place_noise", "share_left"), [(0.0, 0.7), (1e-3, 0.95), (3e-3, 1.2)])
def test_places_that_are_hardly_known_do_hardly_any_harm(place_noise, share_left):
    """The fitted lean is smaller by v/(v + noise^2); regions stay true. Over 60 sessions the errors at 3 mm are the same."""
    before, after, inside = [], [], []
    for seed in range(2):
        pokes, offsets, true = pads(30 + seed, taxels=12, place_noise=place_noise)
        without = find_turns(pokes, FORCE_NOISE_N)
        found = OffsetCorrection().correct(without, {}, (), offsets)
        known = 1e-6 / (1e-6 + place_noise**2)
        assert found.lean.value == pytest.approx(known * LEAN, abs=0.25 * LEAN)
        before.append(errors(without, true)[0])
        angle, share = errors(found.skin, true)
        after.append(angle)
        inside.append(share)
    assert np.mean(after) < share_left * np.mean(before)
    assert np.mean(inside) >= 0.9


def test_an_error_of_the_middle_is_in_the_covariance():
    """All offsets of a taxel are off by 0.7 mm then, and its z leans by 1.7 degrees."""
    inside, normals = [], []
    for seed in range(5):
        pokes, offsets, true = pads(20 + seed, middle_error=0.7e-3)
        found = OffsetCorrection().correct(find_turns(pokes, FORCE_NOISE_N), {}, (), offsets)
        inside.append(errors(found.skin, true)[1])
        normals += [turn.fit.normal_sd for turn in found.skin.taxels.values()]
    assert np.mean(inside) >= 0.9
    assert np.degrees(np.median(normals)) == pytest.approx(1.75, abs=0.4)


def test_a_rigid_skin_has_no_lean_and_keeps_its_turns():
    pokes, offsets, _ = pads(3, lean=0.0)
    without = find_turns(pokes, FORCE_NOISE_N)
    found = OffsetCorrection().correct(without, {}, (), offsets)
    assert abs(found.lean.value) < 3.0 * found.lean.sd < 0.4 * LEAN
    for channel, turn in found.skin.taxels.items():
        assert np.degrees(np.linalg.norm(turn_between(turn.fit.rotation, without.taxels[channel].fit.rotation))) < 0.5


def test_a_lean_within_its_own_error_is_none():
    found = list[float]()
    for seed in range(3, 7):
        pokes, offsets, _ = pads(seed, taxels=2, lean=0.0)
        found.append(OffsetCorrection().correct(find_turns(pokes, FORCE_NOISE_N), {}, (), offsets).lean.value)
    assert 2 <= found.count(0.0) < 4, "two in three lie within it"


def test_unknown_offsets_and_far_ones_change_no_turn():
    pokes, offsets, _ = pads(4)
    without = find_turns(pokes, FORCE_NOISE_N)
    for lost in (np.nan, 8e-3):
        far = {channel: replace(own, offsets=np.full_like(own.offsets, lost)) for channel, own in offsets.items()}
        found = OffsetCorrection().correct(without, {}, (), far)
        assert found.lean.value == 0.0
        assert all(
            (turn.fit.rotation == without.taxels[channel].fit.rotation).all() for channel, turn in found.skin.taxels.items()
        )
    assert OffsetCorrection().correct(without, {}, (), {}).skin is without
    assert OffsetCorrection().correct(without, {}, (), {}).lean.sd == LEAN_PRIOR_SD


def test_a_module_with_one_turn_is_corrected_as_its_taxels_are():
    """Two pokes on each taxel: single taxels say nothing of the lean, the module does."""
    rng = np.random.default_rng(6)
    axes, pokes, offsets = random_rotation(rng), {}, {}
    for channel in range(8):
        made = make_pokes(rng, axes, 2, 15.0, is_noisy=False)
        along = (1e-3 * rng.normal(size=(2, 2)) + [1e-3, 0.0]) @ axes[:, :2].T
        readings = 0.4 * ((made.forces + LEAN * (made.forces @ axes[:, 2])[:, None] * along) @ axes) * [RATIO, RATIO, 1.0]
        pokes[channel] = AxisPokes(made.forces, readings + 0.005 * rng.normal(size=(2, 3)), made.pokes + 10 * channel)
        offsets[channel] = TaxelOffsets(along, np.zeros((3, 3)), axes[:, 2])
    skin = find_turns(pokes, FORCE_NOISE_N)
    module = fit_group(tuple(range(8)), joined(list(pokes.values())), skin.noise)
    found = OffsetCorrection().correct(skin, {3: module}, (3,), offsets)
    assert found.lean.value == pytest.approx(LEAN, rel=0.2)
    z, before, after = axes[:, 2], module.fit.rotation[:, 2], found.modules[3].fit.rotation[:, 2]
    assert np.degrees(np.arccos(before @ z)) > 1.5
    assert np.degrees(np.arccos(after @ z)) < 0.4


def test_offsets_are_where_the_force_axis_crosses_the_skin():
    """The sensor lies elsewhere, turned; a leaning push crosses the plane of the skin at the contact."""
    sensor = np.eye(4)
    sensor[:3, :3], sensor[:3, 3] = rotation_by(np.array([0.4, -0.2, 0.9])), [0.03, 0.02, -0.05]
    place, normal = np.array([0.01, 0.02, 0.03]), np.array([0.0, 0.6, 0.8])
    contacts = []
    for poke, shift in ((4, [1e-3, 0.0, 0.0]), (2, [0.0, 0.8e-3, -0.6e-3])):
        force = np.array([1.0, -3.0, -6.0])
        moment = np.cross(place + shift - sensor[:3, 3], force)
        turned = sensor[:3, :3].T
        contacts.append(
            Contact(
                poke, 0.0, 0.3, turned @ force, turned @ moment, np.array([5]), np.array([9.0 - poke]), sensor, "", 0.0, True,
                vectors=np.array([[0.0, 0.0, -9.0]]),
            )
        )  # fmt: skip
    own = {5: AxisPokes(np.array([[1.0, -3.0, -6.0]] * 3), -np.ones((3, 3)), np.array([2, 3, 4]))}
    known = Estimate(5, Method.MODULES, State.TOUCHED, 2, position=place, normal=normal, covariance=1e-8 * np.eye(3))
    evidence = ContactTable(contacts).evidence([5])
    found = measure_offsets(evidence, {5: known}, own)[5]
    assert found.offsets[[0, 2]] == pytest.approx(np.array([[0.0, 0.8e-3, -0.6e-3], [1e-3, 0.0, 0.0]]), abs=1e-12)
    # Poke 3 has no force axis here.
    assert np.isnan(found.offsets[1]).all()
    assert measure_offsets(evidence, {5: replace(known, position=None)}, own) == {}
    assert measure_offsets(evidence, {}, own) == {}

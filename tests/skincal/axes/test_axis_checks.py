"""Dead axes, pokes with another shear, and z off the mesh: named if they are there, and only then."""

from dataclasses import replace

import numpy as np
import pytest

from skincal.axes.axis_checks import (
    MAX_SHARE_OF_FORCE,
    find_dead_axes,
    find_dead_z,
    find_mesh_lean,
    find_shear_misses,
    find_unit_excess,
)
from skincal.axes.module_axes import AxisFindings
from skincal.axes.session_turns import SessionTurns
from skincal.axes.skin_turns import find_turns
from skincal.axes.taxel_frames import FrameState, frames_of_taxels
from skincal.axes.turn_fit import AxisPokes
from skincal.contacts.value_order import ValueOrderCounts
from skincal.geometry import rotation_by
from skincal.words.axis_words import dead_axis_sentence, mesh_lean_sentence, shear_miss_sentence, unit_excess_sentence
from tests.skincal.axes.axis_support import FORCE_NOISE_N, make_pokes, random_rotation
from tests.skincal.contacts.test_three_axes import axes_with, press_once

TAXELS = 4


def skin(seed, change=None, *, pokes=10, lean=15.0):
    """Find the turns of some taxels; poke k presses taxels 0 and 1 together, and later ones 2 and 3. `change` edits taxel 1."""
    rng, made, axes = np.random.default_rng([5, seed]), {}, {}
    for channel in range(TAXELS):
        axes[channel] = random_rotation(rng)
        own = make_pokes(rng, axes[channel], pokes, lean)
        made[channel] = AxisPokes(own.forces, own.readings, own.pokes + 100 * (channel // 2))
    if change is not None:
        forces, readings = made[1].forces.copy(), made[1].readings.copy()
        change(forces, readings)
        made[1] = AxisPokes(forces, readings, made[1].pokes)
    return find_turns(made, FORCE_NOISE_N), axes


def stick_x(_, readings):
    readings[:, 0] = 0.0


def weaken_y(_, readings):
    readings[:, 1] *= 0.05


@pytest.mark.parametrize(("change", "axis", "is_stuck"), [(stick_x, "x", True), (weaken_y, "y", False)])
def test_a_dead_axis_is_named_and_its_taxel_has_no_frame(change, axis, is_stuck):
    turns, _ = skin(1, change)
    (found,) = find_dead_axes(turns)
    assert (found.channel, found.axis, found.is_stuck, found.pokes) == (1, axis, is_stuck, 10)
    frames = frames_of_taxels(SessionTurns(turns, {}, {}), AxisFindings((), 0.0, ()), range(TAXELS))
    assert [frame.state for frame in frames.values()].count(FrameState.DEAD_AXIS) == 1
    assert frames[1].rotation is None
    assert f"{axis} of taxel 1 " in dead_axis_sentence([found])


def test_a_z_that_never_answers_in_six_pokes_is_dead():
    counts = ValueOrderCounts(20, 15, 0, pushed=(9, 0, 0, 1), sheared=(0, 6, 5, 8))
    (found,) = find_dead_z(counts)
    assert (found.channel, found.axis, found.pokes) == (1, "z", 6)
    assert find_dead_z(ValueOrderCounts()) == ()


@pytest.mark.parametrize("lean", [0.0, 15.0])
def test_good_taxels_and_straight_pokes_have_no_dead_axis_and_no_miss(lean):
    for seed in range(2):
        turns, _ = skin(seed, lean=lean)
        assert find_dead_axes(turns) == find_shear_misses(turns) == ()
    # Nor a taxel whose x is stuck, while no poke leans.
    if not lean:
        assert find_dead_axes(skin(1, stick_x, lean=lean)[0]) == ()


def test_an_axis_that_no_poke_leans_along_or_that_answers_less_is_not_dead():
    turns, axes = skin(1)
    forces = turns.pokes[1].forces @ axes[1]
    forces[:, 0] = 0.0
    one_way = AxisPokes(forces @ axes[1].T, 0.4 * forces * [0.6, 0.6, 1.0], turns.pokes[1].pokes)
    assert find_dead_axes(replace(turns, pokes={**turns.pokes, 1: one_way})) == (), "x cannot answer"

    def weaken_less(_, readings):
        readings[:, 1] *= 0.16

    assert find_dead_axes(skin(1, weaken_less)[0]) == (), "0.1 of z, and 0.16 of a usual y"


def test_a_poke_with_another_shear_than_the_wrench_is_named():
    """All of its taxels must say so: a poke that one of two taxels reads well did not slip."""
    turned = rotation_by(np.array([0.0, np.radians(30.0), 0.0]))

    def turn_force(forces, _):
        forces[3] = turned @ forces[3]

    only_one, _ = skin(2, turn_force)
    assert find_shear_misses(only_one) == ()
    rng, axes = np.random.default_rng(8), random_rotation(np.random.default_rng(9))
    pokes = make_pokes(rng, axes, 12, 15.0)
    pokes.forces[7] = turned @ pokes.forces[7]
    (found,) = find_shear_misses(find_turns({0: pokes}, FORCE_NOISE_N))
    assert (found.poke, found.taxels) == (7, 1)
    assert np.degrees(found.angle) == pytest.approx(20.0, abs=7.0)  # a taxel feels shear 0.6 times
    assert "in poke 7 (" in shear_miss_sentence([found])


def test_z_is_compared_with_the_normal_of_the_mesh():
    turns, axes = skin(3)
    normals = {channel: axis[:, 2] for channel, axis in axes.items()}
    assert find_mesh_lean(turns, normals, ()) is None
    aside = {**normals, 2: rotation_by(np.radians(25.0) * axes[2][:, 0]) @ normals[2]}
    found = find_mesh_lean(turns, aside, ())
    assert (found.channels, found.judged) == ((2,), TAXELS)
    assert np.degrees(found.angle) == pytest.approx(25.0, abs=2.0)
    assert "z of 1 of 4 taxels leans 25" in mesh_lean_sentence(found)
    turn = turns.taxels[2]
    unsure = [replace(fit, covariance=fit.covariance + np.radians(8.0) ** 2 * np.eye(4)) for fit in turn.fits]
    hardly_known = replace(turns, taxels={**turns.taxels, 2: replace(turn, fits=tuple(unsure))})
    assert find_mesh_lean(hardly_known, aside, ()) is None, "three times its error"
    # Taxels in the axes of their module need not be across the skin.
    assert find_mesh_lean(turns, aside, (2,)) is None


def test_taxels_that_push_more_than_the_force_are_not_in_newtons():
    contact = press_once(axes_with())
    force = float(np.linalg.norm(contact.force))
    tenfold = replace(contact, responses=np.array([8.0, 2.0]) * force, channels=np.array([1, 2]))
    assert find_unit_excess([tenfold] * 6) == pytest.approx(10.0)
    assert "10 times its force" in unit_excess_sentence(find_unit_excess([tenfold] * 6))
    few, usual = [tenfold] * 5, [replace(tenfold, responses=np.array([0.5, 0.4]) * MAX_SHARE_OF_FORCE * force)] * 6
    assert find_unit_excess(few) == find_unit_excess(usual) == 0.0
    assert unit_excess_sentence(0.0) == ""

from dataclasses import replace

import numpy as np
import pytest

from skincal.model.errors import InputError
from skincal.simulation.operator import (
    AutoOperator,
    Habits,
    HandPress,
    Move,
    PokeOrder,
    PoseOrder,
    ScriptedOperator,
    press,
    read_order,
)
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.simulated_rig import push_directions, tangents
from tests.approved import approved_pattern
from tests.skincal.sim_support import make_rig


@pytest.fixture(scope="module")
def rig():
    return make_rig(RigErrors.none())


def actions(operator, limit=10_000):
    """Play an operator without devices."""
    now, done = 0.0, []
    while len(done) < limit:
        action = operator.next(now)
        if action is None:
            return done
        now = action.free
        done.append(action)
    return done


def test_auto_pokes_each_taxel_once_a_round(rig, rng):
    presses = actions(AutoOperator(rig, Habits.careful(), rng, pokes=168))
    targets = [int(p.pokes.targets[0]) for p in presses]
    assert sorted(targets[:84]) == sorted(targets[84:]) == rig.channels.tolist()
    assert targets[:84] != targets[84:]


def test_auto_shares_its_pokes_among_the_poses(rig, rng):
    done = actions(AutoOperator(rig, Habits.careful(), rng, pokes=30, poses=("2", "1", "7")))
    moves = [(i, a.arm_pose.name) for i, a in enumerate(done) if isinstance(a, Move)]
    assert moves == [(0, "2"), (11, "1"), (22, "7")]
    assert sum(isinstance(a, HandPress) for a in done) == 30


def test_auto_keeps_to_the_taxels_it_was_given(rig, rng):
    presses = actions(AutoOperator(rig, Habits.careful(), rng, pokes=20, channels=(204, 205)))
    assert {int(p.pokes.targets[0]) for p in presses} == {204, 205}


def test_a_press_is_quiet_rises_holds_and_ends(rig, rng):
    habits = Habits.careful()
    last_free = 0.0
    for p in actions(AutoOperator(rig, habits, rng, pokes=50)):
        assert p.begin - last_free >= habits.approach_s[0]
        assert p.free - p.end >= habits.rest_s[0] - 1e-12
        assert 0.15 <= p.ramp <= 0.30
        assert 0.4 <= p.hold <= 0.8
        times = np.linspace(last_free, p.free, 2001)
        load = p.load(times)
        assert (load[(times < p.begin) | (times > p.end)] == 0).all()
        assert load.min() >= 0
        held = load[(times > p.begin + p.ramp) & (times < p.begin + p.ramp + p.hold)]
        assert held.mean() == pytest.approx(1.0, abs=0.01)
        assert 0.005 < held.std() < 0.02  # tremor
        assert np.abs(np.diff(load)).max() < 0.06  # no step
        last_free = p.free


def test_accidents_come_at_their_rates(rig, rng):
    habits = replace(Habits(), slide_rate=0.2, double_rate=0.1)
    presses = actions(AutoOperator(rig, habits, rng, pokes=600))
    slid = [p for p in presses if p.slide.any()]
    double = [p for p in presses if len(p.pokes) == 2]
    assert len(slid) / 600 == pytest.approx(0.2, abs=0.05)
    assert len(double) / 600 == pytest.approx(0.1, abs=0.04)
    for p in slid:
        assert 0.003 <= np.linalg.norm(p.slide) <= 0.006
        assert abs(p.slide @ p.pokes.normals[0]) < 1e-12
        np.testing.assert_allclose(p.travel(np.array([p.begin, p.end]))[1], p.slide)
    for p in double:
        assert 0.2 <= p.pokes.forces[1] / p.pokes.forces[0] <= 0.5
    assert not any(p.slide.any() or len(p.pokes) > 1 for p in actions(AutoOperator(rig, Habits.careful(), rng, pokes=50)))


def test_told_does_its_orders_in_turn(rig, rng):
    operator = ScriptedOperator(rig, Habits.careful(), rng)
    assert operator.next(0.0) is None
    operator.accept(PoseOrder("6"))
    operator.accept(PokeOrder(288, np.radians(25), np.radians(90), 7.5))
    operator.accept(PokeOrder(289))
    move, first, second = actions(operator)
    assert move.arm_pose.name == "6"
    assert first.pokes.targets[0] == 288
    assert first.pokes.forces[0] == 7.5
    assert second.pokes.targets[0] == 289
    normal, push = first.pokes.normals[0], first.pokes.directions[0]
    assert np.degrees(np.arccos(-push @ normal)) == pytest.approx(25.0)
    _, e2 = tangents(first.pokes.normals)
    assert push @ e2[0] == pytest.approx(np.sin(np.radians(25)))  # azimuth 90 degrees is towards e2


def test_orders_are_checked_when_given(rig, rng):
    operator = ScriptedOperator(rig, Habits.careful(), rng)
    with pytest.raises(InputError, match=approved_pattern("operator.no_taxel", channel=0)):
        operator.accept(PokeOrder(0))
    with pytest.raises(InputError, match="'9'"):
        operator.accept(PoseOrder("9"))
    assert operator.next(0.0) is None


def test_lines_of_orders_are_read():
    assert read_order("  \n") is None
    assert read_order("poke 204\n") == PokeOrder(204)
    assert read_order("poke 204 30 90 8.5") == PokeOrder(204, np.radians(30), np.radians(90), 8.5)
    assert read_order("pose 7") == PoseOrder("7")


@pytest.mark.parametrize(
    "line", ["poke", "poke x", "poke 204 30", "poke 204 30 90", "poke 1 95 0 8", "poke 1 0 0 -2", "poke 1 0 nan 5", "jump 3"]
)
def test_a_line_that_is_no_order_is_named(line):
    with pytest.raises(InputError, match=approved_pattern("operator.no_order")):
        read_order(line)


def test_azimuth_zero_is_along_the_links_x():
    normals = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    pushes = push_directions(normals, np.full(3, np.radians(30)), np.zeros(3))
    np.testing.assert_allclose(pushes[:2, 0], 0.5, atol=1e-12)
    np.testing.assert_allclose(pushes[2, 1], 0.5, atol=1e-12)  # where x is the normal, y takes its place
    np.testing.assert_allclose(-np.sum(pushes * normals, axis=1), np.cos(np.radians(30)))


def test_a_slow_aim_is_not_needed_for_a_press(rig, rng):
    one = press(rig, AutoOperator(rig, Habits.careful(), rng).next(0.0).pokes, 3.0, Habits.careful(), rng)
    assert one.begin > 3.0
    assert len(one.pokes) == 1

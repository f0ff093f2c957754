"""Hands unlike the one that the guide was made with: how they push, and what they come to; more in `tests/long`."""

from dataclasses import replace

import numpy as np
import pytest

from skincal.robot.target_lines import PokeTarget
from skincal.simulation.operator import OPERATORS, GuidedOperator, Habits, apply_bias
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.simulated_rig import push_directions, tangents
from tests.skincal.sim_support import ask_on, make_rig
from tests.skincal.simulation.operators_support import followed

NORMALS = np.array([[0.0, 0.0, 1.0], [0.0, 0.6, 0.8], [0.0, -1.0, 0.0]])


def leans(pushes, normals):
    """Tilts and azimuths of pushes (n, 3), radians."""
    e1, e2 = tangents(normals)
    x, y, z = (np.sum(pushes * e, axis=1) for e in (e1, e2, -normals))
    return np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)


@pytest.mark.parametrize("azimuth", [-2.0, 0.3, 3.0])
def test_without_habits_a_push_is_as_meant(azimuth):
    meant = push_directions(NORMALS, np.full(3, 0.4), np.full(3, azimuth))
    np.testing.assert_allclose(apply_bias(meant, NORMALS, Habits()), meant, atol=1e-12)


def test_a_biased_hand_leans_to_its_side_and_one_on_one_side_nowhere_else():
    straight, bias = -NORMALS, OPERATORS["biased"]
    tilts, azimuths = leans(apply_bias(straight, NORMALS, bias), NORMALS)
    np.testing.assert_allclose(tilts, bias.bias, atol=1e-12)
    np.testing.assert_allclose(azimuths, bias.side, atol=1e-12)
    one = OPERATORS["one_side"]
    for azimuth in (-3.0, -1.0, 2.0):
        meant = push_directions(NORMALS, np.full(3, 0.3), np.full(3, azimuth))
        np.testing.assert_allclose(leans(apply_bias(meant, NORMALS, one), NORMALS)[1], one.side, atol=1e-12)


def test_a_hand_that_reaches_an_arc_pushes_from_nowhere_else():
    arc = OPERATORS["arc"]
    for azimuth in np.linspace(-3.1, 3.1, 12):
        meant = push_directions(NORMALS, np.full(3, 0.3), np.full(3, azimuth))
        tilts, azimuths = leans(apply_bias(meant, NORMALS, arc), NORMALS)
        np.testing.assert_allclose(tilts, 0.3, atol=1e-12)
        off = np.angle(np.exp(1j * (azimuths - arc.side)))
        assert (np.abs(off) <= arc.arc / 2 + 1e-9).all()
        inside = abs(np.angle(np.exp(1j * (azimuth - arc.side)))) < arc.arc / 2
        assert np.allclose(azimuths, azimuth) == inside


@pytest.mark.parametrize("channel", [None, 204], ids=["own choice", "target"])
@pytest.mark.parametrize("known", [False, True])
def test_a_guided_hand_pushes_by_its_habits_whatever_it_pokes(channel, known):
    rig = make_rig(RigErrors.none())
    row = rig.row_of(204)
    # Without a hand's error a poke lies just in its arc; what is asked for lies on the other side of the part.
    hand = replace(OPERATORS["arc"], hand=0.0, ignores=1.0 if channel is None else 0.0)
    e1, e2 = tangents(rig.normals[row : row + 1])
    across = np.cos(hand.side + np.pi) * e1[0] + np.sin(hand.side + np.pi) * e2[0]
    push = np.sin(0.35) * across - np.cos(0.35) * rig.normals[row]
    guided, presses, now = GuidedOperator(rig, hand, np.random.default_rng(4)), [], 0.0
    guided.show(PokeTarget(1, None if known else channel, rig.places[row], push, known=known))
    ask_on(guided)
    while len(presses) < 60:
        action = guided.next(now)
        now = now + 0.1 if action is None else action.free
        presses += [] if action is None else [action]
    pushes, normals = (np.concatenate([getattr(each.pokes, name) for each in presses]) for name in ("directions", "normals"))
    tilts, azimuths = leans(pushes, normals)
    off = np.angle(np.exp(1j * (azimuths - hand.side)))
    assert (np.abs(off[tilts > 0.02]) <= hand.arc / 2 + 1e-9).all()
    assert tilts.max() > 0.2


@pytest.mark.parametrize("operator", ["two_taxels", "one_side"])
def test_whoever_pokes_hardly_a_taxel_that_is_done_is_far_off(operator):
    ended = [followed(operator, seed) for seed in (1, 2, 3)]
    assert all(each.enough for each in ended)
    assert sum(each.far for each in ended) <= 0.04 * sum(each.done for each in ended)
    assert not any(each.beyond for each in ended)

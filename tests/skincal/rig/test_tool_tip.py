"""The tip of a tool from force axes made by hand: where they meet, with its error, and wrong settings that they show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skincal.contacts.outcome import Contact
from skincal.model.scene import NoiseSettings
from skincal.rig.tip_frame import TIP_FRAME_MIN_POKES, TipState
from skincal.rig.tool_tip import find_tool_tip, fit_axes_tip
from skincal.words.part_words import tool_tip_sentence

NOISE = NoiseSettings()
TIP = np.array([0.004, -0.002, 0.15])
LONGER, BESIDE = np.array([0.0, 0.0, 0.06]), np.array([0.035, 0.0, 0.0])


def contacts(rng, count=20, tip=TIP, lean=0.25, about=(0.0, 0.0, 0.0), roll_sd=0.0005):
    """Pokes in the sensor's frame: pushes of 8 N that lean against the tool by up to `lean`, through a tip that rolls."""
    made = []
    for poke in range(1, count + 1):
        angle, around = lean * np.sqrt(rng.uniform()), rng.uniform(-np.pi, np.pi)
        force = 8.0 * np.array([np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around), np.cos(angle)])
        moment = np.cross(tip + rng.normal(0.0, roll_sd, 3) - about, force)
        none = np.empty(0, dtype=np.int64)
        made.append(
            Contact(
                poke, poke, poke + 0.3, force + rng.normal(0.0, NOISE.force, 3), moment + rng.normal(0.0, NOISE.moment, 3),
                none, np.empty(0), np.eye(4), "tool", 0.0, True,
            )
        )  # fmt: skip
    return made


def test_the_error_of_the_tip_is_the_predicted_one():
    squares = []
    for seed in range(80):
        found = fit_axes_tip(contacts(np.random.default_rng(seed)), NOISE)
        off = found.place - TIP
        squares.append(off @ np.linalg.solve(found.covariance, off))
    assert 1.5 < np.median(squares) < 3.6  # chi-square with 3 degrees of freedom: 2.37


def test_the_tip_is_used_from_a_dozen_pokes_on():
    few = find_tool_tip(contacts(np.random.default_rng(1), TIP_FRAME_MIN_POKES - 1), NOISE, None, 0.0005)
    assert few.state is TipState.FEW_POKES
    found = find_tool_tip(contacts(np.random.default_rng(1), TIP_FRAME_MIN_POKES, lean=0.5), NOISE, None, 0.0005)
    assert found.state is TipState.USED
    assert np.linalg.norm(found.shift - TIP) < 0.012
    assert "meet at" in tool_tip_sentence(found)


def test_pushes_along_the_tool_leave_the_tip_open_and_say_so():
    found = find_tool_tip(contacts(np.random.default_rng(2), 30, lean=0.0), NOISE, None, 0.0005)
    assert found.state is TipState.AMBIGUOUS
    assert abs(found.axes.open_direction[2]) > 0.99
    assert "leave it open along" in tool_tip_sentence(found)


@pytest.mark.parametrize("seed", range(5))
def test_a_right_tip_of_the_scene_is_used_and_a_wrong_one_named(seed):
    made = contacts(np.random.default_rng(seed), 20)
    assert find_tool_tip(made, NOISE, TIP, 0.0005).state is TipState.USED
    wrong = find_tool_tip(made, NOISE, TIP + LONGER, 0.0005)
    assert wrong.state is TipState.DISAGREES
    said = tool_tip_sentence(wrong)
    assert "from tip_mm of the scene. The tip is not used" in said
    assert find_tool_tip(made, NOISE, TIP + BESIDE, 0.0005).is_mismatch


@pytest.mark.parametrize("lean", [0.0, 0.01, 0.02, 0.05, 0.1])
@pytest.mark.parametrize("pokes", [20, 100])
def test_noise_that_looks_like_a_lean_names_no_right_tip_and_draws_none_to_the_sensor(lean, pokes):
    """The noise of 0.1 N leans a push of 8 N by 0.7 degrees; uncorrected, the tip lies at the sensor and is called certain."""
    squares, away = [], []
    for seed in range(40):
        found = find_tool_tip(contacts(np.random.default_rng(seed), pokes, lean=lean), NOISE, TIP, 0.0005)
        assert found.state is TipState.USED
        off = found.axes.place - TIP
        squares.append(off @ np.linalg.solve(found.axes.covariance, off))
        if found.axes.sd < 0.1:
            away.append(off[2] / found.axes.sd)
    assert np.median(squares) < 3.6  # chi-square with 3 degrees of freedom: 2.37
    assert np.quantile(squares, 0.9) < 8.0  # 6.25
    assert lean > 0.02 or not away, "nothing shows the tip along the pushes"
    assert lean < 0.05 or abs(np.mean(away)) < 0.5


def test_a_tip_that_the_axes_cannot_check_is_used_and_the_open_direction_named():
    made = contacts(np.random.default_rng(4), 50, lean=0.01)
    for tip in (TIP, TIP - LONGER):
        found = find_tool_tip(made, NOISE, tip, 0.0005)
        assert found.state is TipState.USED
        assert "do not show it along" in tool_tip_sentence(found)
    assert "do not show" not in tool_tip_sentence(find_tool_tip(contacts(np.random.default_rng(4), 50), NOISE, TIP, 0.0005))


@pytest.mark.parametrize("seed", range(5))
def test_moments_about_another_point_move_the_tip_and_are_named(seed):
    made = contacts(np.random.default_rng(seed), 20, about=np.array([0.0, 0.0, 0.05]))
    assert find_tool_tip(made, NOISE, TIP, 0.0005).is_mismatch


def test_a_wrench_in_other_axes_does_not_meet_at_a_tip():
    made = contacts(np.random.default_rng(3), 30, lean=0.5)
    turned = [replace_wrench(each, np.random.default_rng(each.poke)) for each in made]
    found = find_tool_tip(turned, NOISE, TIP, 0.0005)
    assert found.state is TipState.DISAGREES
    assert "do not meet at one tip" in tool_tip_sentence(found)


def replace_wrench(contact, rng):
    """The axes of a base, which the tool turns in."""
    turn = Rotation.random(random_state=int(rng.integers(1 << 30))).as_matrix()
    return replace(contact, force=turn @ contact.force, moment=turn @ contact.moment)

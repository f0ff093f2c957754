"""Rests of a tool before a touch of the fixed-point test: poses that move, turn or stop."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skincal.model.errors import InputError
from skincal.rig.touch_series import RestWindow


def pose(place=(0.4, 0.1, 0.3), turn=0.0):
    """Upper rows of a pose."""
    rows = np.eye(4)[:3]
    rows[:, :3], rows[:, 3] = Rotation.from_rotvec([0.0, turn, 0.0]).as_matrix(), place
    return rows.ravel()


def after(poses, *, every_s=0.02, wait_s=0.0):
    """What a window says after poses that come one after the other; empty at rest."""
    window = RestWindow()
    for number, one in enumerate(poses):
        window.add(number * every_s, [one])
    try:
        window.require_rest((len(poses) - 1) * every_s + wait_s)
    except InputError as error:
        return str(error)
    return ""


def test_a_tool_at_rest_may_be_read_after_half_a_second():
    assert after([pose()] * 27) == ""
    assert "has just begun" in after([pose()] * 20)
    assert after([pose((0.5, 0.1, 0.3))] * 30 + [pose()] * 27) == "", "where it was before does not matter"
    assert after([pose((0.4 + 1e-5 * k, 0.1, 0.3)) for k in range(40)]) == "", "a robot trembles"


@pytest.mark.parametrize(
    ("poses", "says"),
    [
        ([pose((0.4, 0.1, 0.3 + 1e-4 * k)) for k in range(40)], "The tool moved by 2.5 mm in the last 0.5 s"),
        ([pose(turn=0.002 * k) for k in range(40)], "The tool turned by 2.9° in the last 0.5 s"),
        ([pose()] * 27 + [np.full(12, np.nan)] * 27, "0 poses came in the last 0.5 s; expected 3 or more"),
    ],
)
def test_a_tool_that_moves_turns_or_is_lost_is_said(poses, says):
    assert says in after(poses)


def test_a_stream_that_stopped_is_said():
    assert "0 poses came in the last 0.5 s" in after([pose()] * 40, wait_s=0.6)

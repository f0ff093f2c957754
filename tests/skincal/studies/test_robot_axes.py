"""Errors of a robot's session with taxels of three axes against the truth, from turns that are known; no physics."""

from dataclasses import replace

import numpy as np
import pytest

from skincal.geometry import rotation_by
from skincal.studies.robot_axes import fingertip_errors, robot_row, robot_text
from skincal.taxels.result import Method
from tests.app.scene3d_support import estimate, snapshot
from tests.skincal.axes.turn_support import QUARTER, turn_of, turns_of

PLACES = {3: np.array([0.01, 0.0, 0.0]), 4: np.array([0.0, 0.02, 0.0])}


def test_errors_are_those_of_the_truth():
    turns = turns_of({3: turn_of(3, QUARTER, pokes=30), 4: turn_of(4, QUARTER, lean_deg=0.0)})
    known = {channel: estimate(channel, place + np.array([0.0, 0.0, 1e-3])) for channel, place in PLACES.items()}
    made = snapshot(1, known)
    made = replace(made, estimates={Method.MODULES: made.estimates[Method.FREE]}, turns=turns)
    found = fingertip_errors(made, PLACES, {3: QUARTER @ rotation_by(np.radians([0.0, 4.0, 9.0])), 4: QUARTER})
    assert found["position_mm"] == pytest.approx([1.0, 1.0])
    # Taxel 4 has no turn in the plane: no poke leaned.
    assert found["normal_deg"] == pytest.approx([4.0], abs=1.0)
    assert found["plane_deg"] == pytest.approx([9.0], abs=1.5)
    assert found["inside"] == [False]
    row = robot_row(True, [{"pokes": 40, "enough": True, **found}, {"pokes": 60, "enough": False, **found}])
    assert (row["pokes"], row["enough"], row["taxels"], row["inside"]) == (50.0, 0.5, 2, 0.0)
    assert "position 1.00, 1.00 mm" in robot_text(row)
    right = fingertip_errors(made, PLACES, {3: turns.of_channel(3).fit.rotation})
    assert right["normal_deg"] == pytest.approx([0.0], abs=1e-5)
    assert right["inside"] == [True]

"""Axes of taxels in a truth file: written, read back, and refused if they are no rotation."""

import json

import numpy as np
import pytest

from skincal.files.reference import read_places, truth_as_json
from skincal.geometry import rotation_by
from skincal.model.errors import InputError


def test_axes_come_back_from_a_truth_file(tmp_path):
    axes = np.stack([np.eye(3), rotation_by(np.array([0.3, -0.2, 1.0]))])
    path = tmp_path / "truth.json"
    truth = truth_as_json("tip", np.array([4, 7]), np.zeros((2, 3)), np.tile([0.0, 0.0, 1.0], (2, 1)), axes)
    path.write_text(json.dumps(truth))
    found = read_places(path).axes
    assert sorted(found) == [4, 7]
    assert np.array_equal(found[7], axes[1])
    # The first row of the file holds the x components of the three axes.
    assert truth["taxels"][1]["rotation"][0] == axes[1][0].tolist()
    truth["taxels"][0]["rotation"][0][0] = 2.0
    path.write_text(json.dumps(truth))
    with pytest.raises(InputError, match="not a reference"):
        read_places(path)


def test_a_truth_of_one_axis_is_as_before(tmp_path):
    truth = truth_as_json("tip", np.array([4]), np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]))
    assert truth["taxels"] == [{"channel": 4, "position_m": [0.0, 0.0, 0.0], "normal": [0.0, 0.0, 1.0]}]
    path = tmp_path / "truth.json"
    path.write_text(json.dumps(truth))
    assert read_places(path).axes == {}

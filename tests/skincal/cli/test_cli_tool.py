"""`skincal tool`: a file of touches, as a robot writes them."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skincal.cli import main
from tests.skincal.rig.test_pivot import POINT, TIP, touch

TURNS, PLACES = touch(np.random.default_rng(8))


def written(tmp_path, rows, head=""):
    path = tmp_path / "touches.csv"
    path.write_text(head + "\n".join(",".join(f"{value:.6f}" for value in row) for row in rows), encoding="utf-8")
    return path


def test_touches_of_one_point_give_the_tip(tmp_path, capsys):
    rows = np.hstack([PLACES * 1e3, TURNS.as_quat()])
    path = written(tmp_path, rows, "x,y,z,qx,qy,qz,qw\n# by hand\n")
    assert main(["tool", str(path), "--unit", "mm", "--rotation", "xyzw", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["state"] == "agrees"
    np.testing.assert_allclose(result["tip_mm"], TIP * 1e3, atol=3.5 * result["tip_sd_mm"])
    np.testing.assert_allclose(result["point_mm"], POINT * 1e3, atol=2.0)
    assert len(result["miss_mm"]) == len(rows)
    assert main(["tool", str(path), "--unit", "mm"]) == 0
    assert "quaternion x y z w" in capsys.readouterr().out


def test_a_wrong_form_is_a_finding_with_exit_code_2(tmp_path, capsys):
    path = written(tmp_path, np.hstack([PLACES, TURNS.as_rotvec()]))
    assert main(["tool", str(path), "--unit", "m", "--rotation", "rpy"]) == 2
    assert "read as rotation vector" in capsys.readouterr().out


def test_a_known_tip_is_compared(tmp_path, capsys):
    path = written(tmp_path, np.hstack([PLACES, TURNS.as_rotvec()]))
    assert main(["tool", str(path), "--unit", "m", "--tip", "0", "0", "0"]) == 0
    assert "those of the flange" in capsys.readouterr().out


def test_inverse_poses_are_told_by_the_length_of_the_tip(tmp_path, capsys):
    # A point 1.5 m from the base.
    places = PLACES + np.array([1.4, 0.0, 0.0])
    path = written(tmp_path, np.hstack([-TURNS.inv().apply(places), TURNS.inv().as_rotvec()]))
    assert main(["tool", str(path), "--unit", "m", "--rotation", "vector"]) == 0
    assert "those of the base in the tool's frame" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("rows", "options", "says"),
    [
        (np.hstack([PLACES, TURNS.as_rotvec()])[:3], ["--unit", "m"], "has 3 touches; expected 4 or more"),
        (PLACES, ["--unit", "m"], "3 values; expected 6, 7, 12 or 16"),
        (np.hstack([PLACES, TURNS.as_rotvec()]), ["--unit", "mm"], "check the unit"),
        (np.hstack([PLACES * 1e3, TURNS.as_rotvec()]), ["--unit", "m"], "check the unit of the lengths"),
        (np.hstack([PLACES, TURNS.as_rotvec()]), ["--unit", "m", "--rotation", "xyzw"], "has 6 values; expected 7"),
        (np.hstack([PLACES, TURNS.as_rotvec()]), ["--unit", "m", "--degrees"], "--degrees needs a --rotation"),
        (np.hstack([PLACES, np.zeros((6, 4))]), ["--unit", "m", "--rotation", "xyzw"], "line 1: has a quaternion that is not"),
    ],
)
def test_bad_input_is_one_sentence(tmp_path, capsys, rows, options, says):
    assert main(["tool", str(written(tmp_path, rows)), *options]) == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.count("\n") == 1


def test_a_header_with_another_order_of_the_quaternion_is_said(tmp_path, capsys):
    rows = np.hstack([PLACES, TURNS.as_quat()])
    path = written(tmp_path, rows, "x,y,z,qx,qy,qz,qw\n")
    assert main(["tool", str(path), "--unit", "m", "--rotation", "xyzw"]) == 0
    capsys.readouterr()
    assert main(["tool", str(path), "--unit", "m", "--rotation", "wxyz"]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "name the quaternion in the order x y z w, and --rotation is wxyz" in said


@pytest.mark.parametrize(
    ("names", "options", "says"),
    [
        ("x [mm],y [mm],z [mm],rx,ry,rz", [], "name the lengths in mm, and --unit is m"),
        ("x y z rx_deg ry_deg rz_deg", ["--rotation", "vector"], "name the angles in deg, and --degrees is not given"),
        ("rx;ry;rz;x;y;z", [], "the rotation before the place; expected x y z, then the rotation"),
        ("a_x,a_y,a_z,b_x,b_y,b_z", [], "the places of several things; expected the place x y z and the rotation of one tool"),
        ("x_m,y_m,z_m,rx,ry,rz", [], ""),
    ],
)
def test_a_header_of_other_units_or_another_order_is_said(tmp_path, capsys, names, options, says):
    path = written(tmp_path, np.hstack([PLACES, TURNS.as_rotvec()]), f"{names}\n")
    assert main(["tool", str(path), "--unit", "m", *options]) == (2 if says else 0)
    assert says in " ".join(capsys.readouterr().err.split())


def test_a_line_of_words_or_of_another_length_is_named(tmp_path, capsys):
    path = written(tmp_path, np.hstack([PLACES, Rotation.identity(len(PLACES)).as_rotvec()]))
    lines = path.read_text(encoding="utf-8").splitlines()
    for line, says in (("1,2,lost", "line 4: is '1,2,lost'"), ("1,2,3", "line 4: has 3 values; expected 6")):
        path.write_text("\n".join([*lines[:3], line, *lines[3:]]), encoding="utf-8")
        assert main(["tool", str(path), "--unit", "m"]) == 2
        assert says in capsys.readouterr().err

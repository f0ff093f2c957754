"""Wrenches, the arm's chain and the flat layout against truth and published numbers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skincal.geometry import (
    Arm,
    DhLink,
    axis_point,
    cross_matrix,
    inverse_pose,
    move_wrench,
    pitch,
    rotation_by,
    rotation_vector,
)
from skincal.model.skin import MODULE_KINDS, Layout, Module

V1 = Arm(
    (3, 4),
    (DhLink(0.015, 0, np.pi / 2, 0), DhLink(0, -0.1373, np.pi / 2, -np.pi / 2)),
    np.array([[-1.0, 0, 0, 0], [0, 0, 1, -0.08428], [0, 1, 0, 0], [0, 0, 0, 1]]),
)
vectors = st.lists(st.floats(-10, 10), min_size=3, max_size=3).map(np.array)


@given(vectors, vectors)
def test_cross_matrix_is_the_cross_product(a, b):
    assert np.allclose(cross_matrix(a) @ b, np.cross(a, b), atol=1e-12)


def test_axis_passes_through_the_contact_and_pitch_is_zero():
    rng = np.random.default_rng(1)
    contact, force = rng.normal(size=(50, 3)), rng.normal(size=(50, 3)) + 3.0
    moment = np.cross(contact, force)
    foot = axis_point(force, moment)
    assert np.abs(np.cross(contact - foot, force)).max() < 1e-12
    assert np.abs(pitch(force, moment)).max() < 1e-12
    assert np.allclose(pitch(force, moment + 0.01 * force), 0.01)


@given(vectors, vectors, st.floats(-90, 90), st.floats(-90, 90))
def test_a_moved_wrench_still_fits_its_contact(contact, force, j3, j4):
    pose = V1.link_from_sensor(np.radians([j3, j4]))
    force_link, moment_link = move_wrench(pose, force, np.cross(contact, force))
    contact_link = pose[:3, :3] @ contact + pose[:3, 3]
    assert np.allclose(np.cross(contact_link, force_link), moment_link, atol=1e-9)
    assert np.isclose(np.linalg.norm(force_link), np.linalg.norm(force))


@pytest.mark.parametrize(
    ("angles", "wrist_mm"),
    [((94, 0), (138.0, 0, 89.7)), ((15, -90), (21.0, 0, 220.8)), ((35, -40), (66.5, 0, 205.4)), ((45, 0), (86.5, 0, 192.0))],
)
def test_v1_chain_puts_the_wrist_where_the_icub_has_it(angles, wrist_mm):
    """Wrist origin in the sensor frame for Table I, from the authors' iDyn constants, to 0.05 mm."""
    wrist = inverse_pose(V1.link_from_sensor(np.radians(angles)))[:3, 3] * 1e3
    assert np.allclose(wrist, wrist_mm, atol=0.051)


def test_layout_turns_and_mirrors_like_the_robots_gui():
    """p = c + R(theta) (mirror ? (-x, y) : (x, y)), worked by hand for one pad."""
    kind = MODULE_KINDS["triangle_12"]
    plain = Module(1, kind, 0, np.array([0.02, 0.01]), np.pi / 2, False)
    mirrored = Module(1, kind, 0, np.array([0.02, 0.01]), np.pi / 2, True)
    assert np.allclose(plain.pads[0] * 1e3, [20 + 1.443, 10 + 7.5])
    assert np.allclose(mirrored.pads[0] * 1e3, [20 + 1.443, 10 - 7.5])


def test_thermal_pads_are_not_taxels():
    layout = Layout((Module(3, MODULE_KINDS["triangle_10pad"], 36, np.zeros(2), 0.0, False),), 48)
    assert layout.channels.tolist() == [36, 37, 38, 39, 40, 41, 43, 44, 45, 47]
    assert layout.module_of[42] == -1
    assert layout.module_of[47] == 0
    assert layout.spacing == pytest.approx(6.53e-3, abs=0.02e-3)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, 2.9, 3.05, np.pi - 1e-9, np.pi])
def test_a_rotation_vector_gives_its_rotation_back(angle):
    axis = np.array([0.48, -0.6, 0.64])
    found = rotation_vector(rotation_by(angle * axis))
    assert np.linalg.norm(found) == pytest.approx(angle, abs=1e-8)
    assert rotation_by(found) == pytest.approx(rotation_by(angle * axis), abs=1e-8)

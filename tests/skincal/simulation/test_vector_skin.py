"""The simulated skin of three axes: forces on taxels and their readings, from symmetry and by hand."""

from dataclasses import replace

import numpy as np
import pytest

from skincal.simulation.simulated_rig import PressedPlaces
from skincal.simulation.vector_skin import VectorErrors, VectorSkin, random_axes

PLACES = 0.004 * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
NORMALS = np.tile([0.0, 0.0, 1.0], (4, 1))


def press(point, force):
    force = np.array(force, dtype=float)
    size = np.linalg.norm(force)
    one = PressedPlaces(
        np.array([0]), np.array([point], dtype=float), NORMALS[:1], force[None] / size, np.array([size]), np.zeros(1)
    )
    return one, force[None]


def skin(axes=None, **changes):
    rng = np.random.default_rng(3)
    return VectorSkin(
        PLACES, NORMALS, replace(VectorErrors.none(), **changes), rng, np.tile(np.eye(3), (4, 1, 1)) if axes is None else axes
    )


def test_a_taxel_below_the_tip_reads_its_share_of_push_and_shear():
    (reading,) = skin(shear_ratio=0.5).readings(*press([0, 0, 0], [1.0, -0.5, -6.0]))
    assert reading[0] == pytest.approx([0.4 * 0.5 * 1.0, -0.4 * 0.5 * 0.5, -0.4 * 6.0])
    # A push is a negative z on every taxel, and less on the neighbours.
    assert (reading[1:, 2] < 0).all()
    assert (np.abs(reading[1:, 2]) < np.abs(reading[0, 2])).all()


def test_readings_are_in_the_axes_of_each_taxel():
    axes = random_axes(NORMALS, 0.2, np.random.default_rng(4))
    poke = press([0, 0, 0], [1.0, -0.5, -6.0])
    level, turned = skin(shear_ratio=1.0).readings(*poke)[0], skin(axes, shear_ratio=1.0).readings(*poke)[0]
    assert np.einsum("kij,kj->ki", axes, turned) == pytest.approx(level)
    assert axes[:, :, 2] @ [0.0, 0.0, 1.0] == pytest.approx(np.ones(4), abs=0.2)


def test_soft_material_pulls_to_all_sides_and_not_below_the_tip():
    (reading,) = skin(bulge=0.2).readings(*press([0, 0, 0], [0.0, 0.0, -6.0]))
    assert reading[0, :2] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert reading[1, 0] > 0.01
    assert reading[2, 0] == pytest.approx(-reading[1, 0])
    assert reading[3, 1] == pytest.approx(reading[1, 0])


def test_friction_limits_the_shear():
    (reading,) = skin(shear_ratio=1.0, friction=0.5).readings(*press([0, 0, 0], [8.0, 0.0, -6.0]))
    assert reading[0, 0] == pytest.approx(0.5 * 0.4 * 6.0)


def test_neighbours_and_noise_add_what_they_say():
    poke = press([0, 0, 0], [0.0, 0.0, -6.0])
    alone, mixed = skin().readings(*poke)[0], skin(neighbour_crosstalk=0.1).readings(*poke)[0]
    assert mixed[0] == pytest.approx(alone[0] + 0.1 * alone[1:].sum(axis=0))
    noisy = skin(noise=0.05, step=0.0).measured(np.zeros((4000, 3)), np.random.default_rng(5))
    assert noisy.std() == pytest.approx(0.05, rel=0.05)
    stepped = skin(noise=0.05, step=0.1).measured(np.zeros((100, 3)), np.random.default_rng(5))
    assert set(np.unique(np.round(stepped, 9))) <= {-0.2, -0.1, 0.0, 0.1, 0.2}

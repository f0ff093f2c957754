"""Pokes as lines in space: each with its own pose of the sensor, the same numbers alone and among others, frozen."""

import pickle
from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest

from skincal.contacts.outcome import Reason, Rejection
from skincal.geometry import inverse_pose, rotations
from skincal.pokes import NO_LANDMARK_POKES, LandmarkPokes, Pokes
from skincal.rig.correction import Correction, products

COUNT = 40


def poses(rng, count=COUNT):
    made = np.tile(np.eye(4), (count, 1, 1))
    made[:, :3, :3], made[:, :3, 3] = rotations(rng.normal(0, 1, (count, 3))), rng.normal(0, 0.2, (count, 3))
    return made


@pytest.fixture
def pressed(rng):
    """Pokes without a torque at points of the link frame, each in a pose of its own, and these points."""
    places, force, link_from_sensor = rng.normal(0, 0.1, (COUNT, 3)), rng.normal(0, 6, (COUNT, 3)), poses(rng)
    here = np.array([inverse_pose(pose) @ [*place, 1.0] for pose, place in zip(link_from_sensor, places, strict=True)])[:, :3]
    names = np.array(["low", "high"])[rng.integers(0, 2, COUNT)]
    pokes = Pokes(np.arange(1, COUNT + 1), force, np.cross(here, force), link_from_sensor, names)
    return LandmarkPokes.at(pokes, [f"mark {k % 5}" for k in range(COUNT)], places)


def test_the_axis_of_each_poke_passes_its_point_whatever_frame_the_sensor_has_there(pressed, rng):
    assert pressed.landmark_miss.max() < 1e-13
    assert np.abs(pressed.pitch).max() < 1e-15
    aside = np.cross(pressed.direction, rng.normal(size=(COUNT, 3)))
    aside *= 0.004 / np.linalg.norm(aside, axis=1, keepdims=True)
    np.testing.assert_allclose(pressed.miss(pressed.place + aside + 0.3 * pressed.direction), 0.004, rtol=1e-9)
    # The sensor's frame is turned and shifted on its body: other readings of the same lines.
    moved = poses(rng)
    force = (moved[:, :3, :3].transpose(0, 2, 1) @ pressed.force[:, :, None])[:, :, 0]
    about = pressed.moment - np.cross(moved[:, :3, 3], pressed.force)
    moment = (moved[:, :3, :3].transpose(0, 2, 1) @ about[:, :, None])[:, :, 0]
    other = replace(pressed, force=force, moment=moment, link_from_sensor=pressed.link_from_sensor @ moved)
    np.testing.assert_allclose(other.axis_point, pressed.axis_point, rtol=0, atol=1e-12)
    np.testing.assert_allclose(other.direction, pressed.direction, rtol=0, atol=1e-12)
    normals = -pressed.direction @ rotations(np.array([[0.0, 0.0, 0.4]]))[0].T
    cosines = -np.sum(pressed.direction * normals, axis=1)
    np.testing.assert_allclose(other.tilt(normals), np.arccos(cosines), rtol=0, atol=1e-9)


def test_a_poke_has_the_same_bits_alone_among_others_and_from_strided_arrays(pressed, rng):
    points, order = rng.normal(0, 0.1, (COUNT, 3)), rng.permutation(COUNT)
    strided = replace(pressed, force=pressed.wrench[:, :3], moment=pressed.wrench[:, 3:])
    for name in ("axis_point", "direction", "pitch", "force_size", "landmark_miss"):
        every = getattr(pressed, name)
        assert [getattr(poke, name).tobytes() for poke in pressed] == [row.tobytes() for row in every]
        assert getattr(pressed[order], name).tobytes() == every[order].tobytes()
        assert getattr(strided, name).tobytes() == every.tobytes()
    assert pressed[order].miss(points[order]).tobytes() == pressed.miss(points)[order].tobytes()


def test_pokes_are_selected_joined_and_frozen(pressed):
    some = LandmarkPokes.concatenate([pressed[3:5], pressed[pressed.pose == "low"], NO_LANDMARK_POKES])
    assert some.number.tolist() == [4, 5, *pressed.number[pressed.pose == "low"]]
    assert len(some) == len(list(some))
    assert (pressed[2].number, pressed[2].name, pressed[2].force.shape) == (3, "mark 2", (3,))
    for each in fields(some):
        with pytest.raises(ValueError, match="read-only"):
            getattr(some, each.name)[0] = getattr(some, each.name)[1]


def test_pokes_travel_as_their_given_arrays_and_are_frozen_again(pressed):
    fresh = pickle.dumps(pressed)
    assert pressed.landmark_miss.max() < 1e-13
    assert pickle.dumps(pressed) == fresh, "nothing computed travels"
    there = pickle.loads(fresh)
    assert type(there) is LandmarkPokes
    for each in fields(there):
        assert getattr(there, each.name).tobytes() == getattr(pressed, each.name).tobytes()
        with pytest.raises(ValueError, match="read-only"):
            getattr(there, each.name)[0] = getattr(there, each.name)[1]
    assert there.landmark_miss.tobytes() == pressed.landmark_miss.tobytes()
    assert pickle.loads(pickle.dumps(pressed[2])).number == 3


def test_pokes_without_a_wrench_are_left_out():
    bare = Rejection(1, 0.0, 1.0, Reason.SLID, 1.0, 0.5, "", np.empty(0, dtype=np.int64), final=True)
    whole = replace(bare, poke=2, force=np.ones(3), moment=np.zeros(3), link_from_sensor=np.eye(4), pose="low")
    found = Pokes.collect([bare, whole])
    assert (found.number.tolist(), found.pose.tolist(), len(Pokes.collect([bare]))) == ([2], ["low"], 0)


@pytest.mark.parametrize("quadratic", [False, True])
def test_pokes_are_corrected_as_each_of_them_is(pressed, rng, quadratic):
    units = np.repeat([10.0, 3.5], 3)
    bent = 0.01 * rng.normal(size=(6, 21)) * units[:, None] / products(units[None]) if quadratic else np.empty((6, 0))
    everywhere, motion = poses(rng, 2)
    found = Correction(np.eye(6) + 0.02 * rng.normal(size=(6, 6)), everywhere, {"low": motion}, quadratic=bent)
    every = found.corrected_pokes(pressed)
    for row, poke in enumerate(pressed):
        force, moment = found.wrench(poke.force, poke.moment)
        alone = SimpleNamespace(force=force, moment=moment, link_from_sensor=found.pose(poke.link_from_sensor, str(poke.pose)))
        for name in ("force", "moment", "link_from_sensor"):
            assert getattr(every, name)[row].tobytes() == getattr(alone, name).tobytes()

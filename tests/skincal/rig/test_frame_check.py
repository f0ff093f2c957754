"""Three pokes at landmarks: the frame that is wrong is named, the one that is right is left, and nothing is changed."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from skincal.geometry import rotations
from skincal.pokes import LandmarkPokes
from skincal.rig.correction import FRAME, RIG, Correction, RigPrior
from skincal.rig.correction_fit import RigAnswer
from skincal.rig.frame_check import check_frame
from skincal.rig.scene_mistakes import STANDARD_GRAVITY, Mistake, MistakeKind
from skincal.session.corrections import offered
from skincal.session.landmark_pokes import landmark_normals
from skincal.simulation.contacts import poke_landmarks
from skincal.simulation.rig_errors import RigErrors
from skincal.words.mistake_words import frame_sentence
from tests.approved import approved
from tests.skincal.sim_support import make_rig

LAYOUT = 0.004
"""m, by how much landmarks lie beside where the scene puts them."""
TRIALS = 100
BAD = 40
"""Rigs with the paper's errors."""
SLIPS = 25
"""Of these, on which one poke was at another landmark."""


@lru_cache
def rig_of(seed):
    return make_rig(RigErrors.noise(), seed)


def three(trial):
    """Three pokes in the first arm pose, their normals, and the numbers that the rest of the trial is drawn from."""
    rng = np.random.default_rng([trial, 99])
    rig = rig_of(trial % 10 + 1)
    pokes = poke_landmarks(rig, rig.scene.landmarks, 3, rng)[:3]
    beside = LAYOUT / np.sqrt(3.0) * rng.standard_normal((3, 3))
    pokes = replace(pokes, place=pokes.place + beside)
    return pokes, [landmark.normal for landmark in rig.scene.landmarks[:3]], rng


def other_axes(rng):
    while True:
        axes = np.diag(rng.choice([-1.0, 1.0], 3))[rng.permutation(3)]
        if not np.array_equal(axes, np.eye(3)):
            return axes


def turned_by(pokes, axes):
    """Pokes of which a sensor reports the components in another order."""
    return replace(pokes, force=pokes.force @ axes, moment=pokes.moment @ axes)


def mounting(rng):
    motion, turn, shift = np.eye(4), rng.standard_normal(3), rng.standard_normal(3)
    motion[:3, :3] = rotations(np.radians(25.0) * (turn / np.linalg.norm(turn))[None])[0]
    motion[:3, 3] = 0.04 * shift / np.linalg.norm(shift)
    return motion


def said_right(trial):
    """Break the frame in one of five ways, and return whether it is named."""
    pokes, normals, rng = three(trial)
    kind, axes, motion = trial % 5, other_axes(rng), mounting(rng)
    change = (
        lambda pokes: pokes,
        lambda pokes: turned_by(pokes, axes),
        lambda pokes: replace(pokes, moment=1e3 * pokes.moment),
        lambda pokes: replace(pokes, force=pokes.force / STANDARD_GRAVITY),
        lambda pokes: replace(pokes, link_from_sensor=pokes.link_from_sensor @ motion),
    )[kind]
    said = check_frame(change(pokes), normals)
    plain = np.array_equal(said.mistake.axes, np.eye(3))
    return (
        said.right,
        np.array_equal(said.mistake.axes, axes) and said.mistake.moment_scale == 1.0,
        plain and said.mistake.moment_scale == 1e-3 and "newton millimetres" in frame_sentence(said, has_arm=True),
        plain and said.mistake.force_scale == STANDARD_GRAVITY and "kilogram-force" in frame_sentence(said, has_arm=True),
        not np.array_equal(said.mistake.motion, np.eye(4)) and said.corrected_miss < said.miss,
    )[kind]


def test_a_hundred_trials_are_named_right():
    wrong = [trial for trial in range(TRIALS) if not said_right(trial)]
    assert len(wrong) <= 0.01 * TRIALS, wrong


@lru_cache
def on_bad_rigs(count):
    """Of each rig with the paper's errors the first pokes at landmarks, their normals, and another order of the axes."""
    trials = []
    for seed in range(1, BAD + 1):
        rig, rng = make_rig(RigErrors.paper(), seed), np.random.default_rng([seed, 98])
        pokes = poke_landmarks(rig, rig.scene.landmarks, 3, rng)[:count]
        trials.append((pokes, [rig.scene.landmarks[i % 6].normal for i in range(count)], other_axes(rng)))
    return trials


@pytest.mark.parametrize("count", [3, 21])
def test_what_is_ordinarily_wrong_with_a_rig_is_no_wrong_frame(count):
    # Measured: 100 and 100 of 100; without the prior 43 and 14.
    said = [check_frame(pokes, normals) for pokes, normals, _ in on_bad_rigs(count)]
    assert sum(diagnosis.right for diagnosis in said) >= 0.97 * BAD
    none = RigPrior(matrix=0.0, pose_turn=0.0, pose_shift=0.0)
    assert sum(check_frame(pokes, normals, none).right for pokes, normals, _ in on_bad_rigs(count)[:20]) < 0.9 * 20


@pytest.mark.parametrize("count", [3, 21])
def test_on_such_a_rig_another_order_of_the_axes_is_named(count):
    named = 0
    for pokes, normals, axes in on_bad_rigs(count):
        said = check_frame(turned_by(pokes, axes), normals)
        named += np.array_equal(said.mistake.axes, axes) and said.mistake.moment_scale == 1.0
    assert named >= 0.95 * BAD


def same_pokes(pokes, others):
    np.testing.assert_array_equal(pokes.force, others.force)
    np.testing.assert_array_equal(pokes.moment, others.moment)
    np.testing.assert_array_equal(pokes.link_from_sensor, others.link_from_sensor)


def test_a_right_frame_is_left_and_a_wrong_one_is_corrected_by_what_is_offered():
    pokes, normals, _ = three(0)
    said = check_frame(pokes, normals)
    assert said.right
    assert said.sure
    assert said.miss < 0.01
    assert said.corrected_miss == said.miss
    assert "right" in frame_sentence(said, has_arm=True)
    reaction = check_frame(replace(pokes, force=-pokes.force, moment=-pokes.moment), normals)
    # The axis is the same: the side that pushes tells.
    assert reaction.miss == pytest.approx(said.miss)
    assert "reaction" in frame_sentence(reaction, has_arm=True)
    turned = replace(pokes, force=pokes.force[:, [1, 0, 2]], moment=pokes.moment[:, [1, 0, 2]])
    found = check_frame(turned, normals)
    assert approved("sensor_frame.axes_order_clause", order="y, x, z") in frame_sentence(found, has_arm=True)
    assert f"{found.miss * 1e3:.0f} mm" in frame_sentence(found, has_arm=True)
    same_pokes(found.mistake.correction.corrected_pokes(turned), pokes)


def one_elsewhere(count, seed):
    """Pokes on a rig with the paper's errors, one of them at another landmark than listed, their normals, and that poke."""
    rig, rng = make_rig(RigErrors.paper(), seed), np.random.default_rng([seed, 97])
    marks = rig.scene.landmarks
    pokes = poke_landmarks(rig, marks, 3, rng)[:count]
    listed = [i % len(marks) for i in range(count)]
    slip = int(rng.integers(count))
    listed[slip] = (listed[slip] + int(rng.integers(1, len(marks)))) % len(marks)
    pokes = LandmarkPokes.at(pokes, [marks[i].name for i in listed], [marks[i].place for i in listed])
    return pokes, [marks[i].normal for i in listed], pokes[slip]


# Measured before a poke could be at another point: called wrong 22, 14 and 2 times, 18, 12 and 1 times surely.
@pytest.mark.parametrize(("count", "found"), [(3, 20), (6, 20), (21, 0)])
def test_a_poke_at_another_landmark_is_no_wrong_frame(count, found):
    right, blamed, named = 0, 0, 0
    for seed in range(1, SLIPS + 1):
        pokes, normals, slip = one_elsewhere(count, seed)
        said = check_frame(pokes, normals)
        right += said.right
        blamed += not said.right and said.sure
        named += said.other_point is not None and (said.other_point.poke, said.other_point.name) == (slip.number, slip.name)
        # Two pokes that are left tell no frame surely.
        assert not (count == 3 and said.right and said.corrected_miss < said.miss and said.sure)
    assert blamed <= 1
    assert right >= 24
    # Of many only twelve are looked at, and the one may not be among them.
    assert named >= found


def test_a_wrong_frame_is_named_beside_a_poke_at_another_landmark():
    named = 0
    for seed in range(1, SLIPS + 1):
        pokes, normals, slip = one_elsewhere(12, seed)
        axes = other_axes(np.random.default_rng([seed, 96]))
        said = check_frame(turned_by(pokes, axes), normals)
        named += (
            np.array_equal(said.mistake.axes, axes)
            and said.explained
            and said.other_point is not None
            and said.other_point.poke == slip.number
        )
    assert named >= 0.9 * SLIPS


def rig_answer(correction):
    nothing = np.empty(0)
    return RigAnswer(correction, correction is not None, 0.02, 0.002, 6, {}, {}, nothing, nothing)


def test_the_rig_is_offered_before_a_wrong_frame_that_is_not_sure_or_explains_nothing():
    pokes, normals, _ = three(0)
    turned = check_frame(replace(pokes, force=-pokes.force, moment=-pokes.moment), normals)
    rig = rig_answer(Correction(np.eye(6), np.eye(4), {}))
    assert offered(turned, rig, 3, {}).of == FRAME
    assert offered(replace(turned, sure=False), rig, 3, {}).of == RIG
    assert offered(replace(turned, sure=False), rig_answer(None), 3, {}).of == FRAME
    assert offered(replace(turned, explained=False), rig, 3, {}).of == RIG
    assert offered(replace(turned, explained=False), rig_answer(None), 3, {}) is None
    assert offered(check_frame(pokes, normals), rig, 3, {}).of == RIG


def test_what_no_mistake_of_the_frame_explains_is_said_and_not_offered():
    unexplained = 0
    for pokes, normals, _ in on_bad_rigs(21)[:SLIPS]:
        # The landmarks' names went round by one.
        places = np.tile(pokes.place[[1, 2, 3, 4, 5, 0]], (4, 1))
        said = check_frame(replace(pokes, place=places[:21]), normals)
        assert not (said.sure and said.right)
        unexplained += not said.explained
        if not said.explained:
            misses = approved("sensor_frame.unexplained_misses", miss_mm=f"{said.miss * 1000.0:.0f}")
            assert frame_sentence(said, has_arm=True).startswith(misses)
            assert approved("sensor_frame.unexplained") in frame_sentence(said, has_arm=True)
            assert offered(said, rig_answer(None), 21, {}) is None
    assert unexplained >= 0.9 * SLIPS


def test_a_reaction_is_shown_by_the_surface_where_landmarks_have_no_normal():
    rig = rig_of(1)
    bare = [replace(landmark, normal=None) for landmark in rig.scene.landmarks[:3]]
    pokes, _, _ = three(0)
    reaction = replace(pokes, force=-pokes.force, moment=-pokes.moment)
    normals = landmark_normals(bare, rig.surface)
    assert "reaction" in frame_sentence(check_frame(reaction, normals), has_arm=True)
    assert check_frame(pokes, normals).right
    assert landmark_normals(bare, None) == [None] * 3
    blind = check_frame(reaction, [None] * 3)
    assert (blind.right, blind.sure) == (True, False), "without normals the reaction cannot be seen"
    assert check_frame(pokes[:2], normals[:2]) is None
    same_pokes(Mistake(MistakeKind.NONE).correction.corrected_pokes(pokes), pokes)
    away = replace(bare[0], place=bare[0].place + 0.05 * normals[0])
    own = replace(away, normal=np.array([0.0, 0.0, 1.0]))
    found = landmark_normals([away, own], rig.surface)
    assert found[0] is None
    assert found[1] is own.normal

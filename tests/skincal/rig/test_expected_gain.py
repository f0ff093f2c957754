"""What landmark pokes will gain: predicted as it comes out on rigs that are drawn, solved and measured."""

from dataclasses import replace

import numpy as np
import pytest

from skincal.geometry import rotations
from skincal.methods import estimate_taxels
from skincal.modules.pose import ModuleModel
from skincal.pokes import NO_LANDMARK_POKES, LandmarkPokes, Pokes
from skincal.rig.correction import RigPrior
from skincal.rig.correction_fit import MIN_LANDMARK_POKES, RigRequest, correct_rig
from skincal.rig.expected_gain import expected_error, straight_pushes, taxel_pushes
from skincal.simulation.contacts import poke_landmarks, simulate_contacts, unguided
from skincal.simulation.rig_errors import RigErrors
from skincal.taxels.result import Method
from tests.skincal.sim_support import make_rig

PRIOR = RigPrior()


def reported(rig):
    return {name: stance.reported for name, stance in rig.arm_poses.items()}


def planned(rig, per_pose):
    """Straight pushes at landmarks, which each arm pose continues in turn; the normal of each."""
    landmarks, parts, normals = rig.scene.landmarks, [], []
    for at, (name, pose) in enumerate(reported(rig).items()):
        own = [landmarks[(per_pose * at + k) % len(landmarks)] for k in range(per_pose)]
        out = np.array([landmark.normal for landmark in own])
        parts.append(straight_pushes(np.array([landmark.place for landmark in own]), out, {name: pose}))
        normals.append(out)
    return LandmarkPokes.concatenate(parts), np.concatenate(normals)


def gain_of(rig, pokes=NO_LANDMARK_POKES, plan=NO_LANDMARK_POKES, poses=None, **changes):
    places, normals = changes.get("places", rig.places), changes.get("normals", rig.normals)
    return expected_error(pokes, plan, taxel_pushes(places, normals, poses or reported(rig)), rig.scene.noise, PRIOR)


class Drawn:
    """A rig drawn from the prior: its wrenches and poses as they are, read as they are reported."""

    def __init__(self, poses, rng):
        units = np.repeat([1.0, PRIOR.arm], 3)
        self.matrix = np.eye(6) + PRIOR.matrix * rng.standard_normal((6, 6)) * units[:, None] / units
        self.reported, self.true = poses, {}
        for name, pose in poses.items():
            error = np.eye(4)
            error[:3, :3] = rotations(PRIOR.pose_turn * rng.standard_normal((1, 3)))[0]
            error[:3, 3] = PRIOR.pose_shift * rng.standard_normal(3)
            self.true[name] = pose @ error

    def measured(self, places, normals, name):
        """(n, 6) what the sensor tells of straight pushes of 10 N."""
        true = self.true[name]
        force = -10.0 * normals @ true[:3, :3]
        wrench = np.column_stack([force, np.cross((places - true[:3, 3]) @ true[:3, :3], force)])
        return np.linalg.solve(self.matrix, wrench.T).T

    def beside(self, places, normals, correction=None):
        """(n, 3) from places to the axes of pushes at them as they are read, the mean of the poses."""
        total = np.zeros_like(places)
        for name, pose in self.reported.items():
            wrench = self.measured(places, normals, name)
            if correction is not None:
                wrench, pose = wrench @ correction.matrix.T, correction.pose(pose, name)
            push = wrench[:, :3] @ pose[:3, :3].T
            moment = wrench[:, 3:] @ pose[:3, :3].T + np.cross(pose[:3, 3], push)
            # The axis's point nearest to the taxel.
            total += np.cross(push, moment - np.cross(places, push)) / np.sum(push * push, axis=1, keepdims=True)
        return total / len(self.reported)


@pytest.mark.parametrize("names", [["1"], None])
def test_a_rig_that_is_not_corrected_is_off_as_drawn_ones_are(names):
    rig, rng = make_rig(RigErrors.noise(), 1), np.random.default_rng(5)
    poses = {name: pose for name, pose in reported(rig).items() if names is None or name in names}
    drawn = [np.mean(np.sum(Drawn(poses, rng).beside(rig.places, rig.normals) ** 2, axis=1)) for _ in range(600)]
    assert gain_of(rig, poses=poses).now == pytest.approx(np.sqrt(np.mean(drawn)), rel=0.08)


@pytest.mark.parametrize("count", [7, 21])
def test_landmark_pokes_leave_as_much_as_is_predicted(count):
    """By another route: landmark pokes at drawn rigs, with noise, each rig corrected by them as a session's is."""
    rig, rng = make_rig(RigErrors.noise(), 1), np.random.default_rng(6)
    (plan, normals), noise, drawn = planned(rig, count // 7), rig.scene.noise, []
    sds = np.repeat([noise.force, noise.moment], 3)
    for _ in range(16):
        drawn_rig, wrenches = Drawn(reported(rig), rng), []
        for poke, normal in zip(plan, normals, strict=True):
            place = poke.place + PRIOR.landmark * rng.standard_normal(3)
            wrench = drawn_rig.measured(place[None], normal[None], str(poke.pose))[0] + sds * rng.standard_normal(6)
            wrenches.append(wrench)
        force, moment = np.split(np.array(wrenches), 2, axis=1)
        names = [str(place) for place in plan.place]
        pokes = Pokes(np.arange(len(plan)), force, moment, plan.link_from_sensor, plan.pose)
        pokes = LandmarkPokes.at(pokes, names, plan.place)
        answer = correct_rig(RigRequest(rig.scene, rig.surface, [], pokes))
        drawn.append(np.mean(np.sum(drawn_rig.beside(rig.places, rig.normals, answer.correction) ** 2, axis=1)))
    assert gain_of(rig, plan=plan).after == pytest.approx(np.sqrt(np.mean(drawn)), rel=0.15)


def measured_errors(seed):
    """Mean square error, m^2, of the modules on a rig with the paper's errors: as it tells, and corrected by 21 pokes."""
    rng, rig = np.random.default_rng([seed, 5]), make_rig(RigErrors.paper(), seed)
    contacts = []
    for pose in rig.arm_poses:
        contacts += simulate_contacts(rig, unguided(rig, 1, rng), rng, pose, first_poke=len(contacts) * 2 + 1)
    pokes = poke_landmarks(rig, rig.scene.landmarks, 3, rng, 10_001)
    answer = correct_rig(RigRequest(rig.scene, rig.surface, contacts, pokes))
    model = ModuleModel(rig.scene.skin.layout, rig.scene.skin.anchor, rig.surface)
    squares = []
    for some in (contacts, [answer.correction.corrected(contact) for contact in contacts]):
        found = estimate_taxels(some, rig.channels.tolist(), [Method.MODULES], rig.scene.noise, rig.surface, model=model)
        off = [estimate.position - rig.places[row] for row, estimate in enumerate(found[Method.MODULES].values())]
        squares.append(np.mean(np.sum(np.square(off), axis=1)))
    return pokes, squares


def test_what_is_predicted_comes_out_on_simulated_rigs():
    """Measured over 24 rigs: 7.1 and 0.80 mm where 7.5 and 1.0 mm are predicted: pokes on the skin help, too."""
    rig = make_rig(RigErrors.paper(), 1)
    gain = gain_of(rig, plan=planned(rig, 3)[0])
    trials = [measured_errors(seed) for seed in range(1, 5)]
    before, after = np.sqrt(np.mean([squares for _, squares in trials], axis=0))
    assert gain.pokes == 21
    assert 0.75 < before / gain.now < 1.3
    assert 0.6 < after / gain.after < 1.1
    # Planned straight, made by hand from all sides: nearly the same is known.
    assert gain_of(rig, trials[0][0]).now == pytest.approx(gain.after, rel=0.2)


def test_more_pokes_gain_more_and_too_few_nothing():
    rig = make_rig(RigErrors.noise(), 1)
    plan, _ = planned(rig, 3)
    errors = [gain_of(rig, plan=plan[:count]).after for count in range(len(plan) + 1)]
    assert errors[:MIN_LANDMARK_POKES] == [errors[0]] * MIN_LANDMARK_POKES
    assert all(
        after < before for before, after in zip(errors[MIN_LANDMARK_POKES - 1 :], errors[MIN_LANDMARK_POKES:], strict=False)
    )
    pokes = poke_landmarks(rig, rig.scene.landmarks, 3, np.random.default_rng(1))
    half = gain_of(rig, pokes[:9], plan[9:])
    assert half.now == gain_of(rig, pokes[:9]).after
    assert half.after < half.now < errors[0]


def test_a_rigid_motion_of_the_link_changes_nothing():
    rig = make_rig(RigErrors.noise(), 1)
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = rotations(np.array([[0.4, 1.2, -0.3]]))[0], [0.2, 0.1, -0.4]
    turn, shift = motion[:3, :3], motion[:3, 3]
    plan, _ = planned(rig, 1)
    there = replace(plan, place=plan.place @ turn.T + shift, link_from_sensor=motion @ plan.link_from_sensor)
    poses = {name: motion @ pose for name, pose in reported(rig).items()}
    moved = gain_of(rig, NO_LANDMARK_POKES, there, poses, places=rig.places @ turn.T + shift, normals=rig.normals @ turn.T)
    here = gain_of(rig, NO_LANDMARK_POKES, plan)
    assert (moved.now, moved.after) == pytest.approx((here.now, here.after), rel=1e-9)


def test_without_a_taxel_or_an_arm_pose_there_is_nothing_to_predict():
    rig = make_rig(RigErrors.noise(), 1)
    plan, _ = planned(rig, 3)
    with pytest.raises(ValueError, match="no taxel"):
        gain_of(rig, places=np.empty((0, 3)), normals=np.empty((0, 3)))
    with pytest.raises(ValueError, match="no arm pose"):
        expected_error(NO_LANDMARK_POKES, plan, NO_LANDMARK_POKES, rig.scene.noise)

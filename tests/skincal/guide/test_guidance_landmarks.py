"""Which landmark is asked for next, which pokes may have been there, and the guidance that asks for one."""

from dataclasses import replace

import numpy as np
import pytest

from skincal.contacts.outcome import Contact, Reason, Rejection
from skincal.guide import guidance as landmarks_module
from skincal.guide.believed_positions import plan_from_layout
from skincal.guide.guidance import (
    LANDMARK_POKE_MAX_OFFSET_M,
    Guidance,
    GuidePhase,
    LandmarkTarget,
    landmark_targets,
    may_be_at_landmark,
    rig_error_sd,
)
from skincal.mesh.lay import place_layout
from skincal.model.scene import Landmark
from skincal.rig.expected_gain import Gain
from skincal.session.session import Session
from skincal.simulation.contacts import poke_landmarks, simulate_contacts, unguided
from skincal.simulation.rig_errors import RigErrors
from skincal.taxels.result import Method
from tests.skincal.estimate_support import believed_positions
from tests.skincal.sim_support import make_rig

FAR, MIDDLE, NEAR = (
    Landmark(name, np.array([x, 0.0, 0.0]), None) for name, x in (("far", 0.3), ("middle", 0.2), ("near", 0.1))
)
LANDMARKS = (NEAR, MIDDLE, FAR)
FOUR = (*LANDMARKS, Landmark("aside", np.array([0.2, 0.1, 0.0]), None))


@pytest.fixture(autouse=True)
def three_are_enough(request, monkeypatch):
    """Three landmarks stand for as many as a correction takes: with four each case is longer and says the same."""
    if "needs_four" not in request.fixturenames:
        monkeypatch.setattr(landmarks_module, "MIN_LANDMARKS", 3)


@pytest.fixture
def needs_four():
    """Ask for as many landmarks as a correction takes."""


def names(targets):
    return [target.landmark.name for target in targets]


def at(pose, *named):
    """Landmark pokes of one arm pose."""
    return [(pose, name) for name in named]


SIX_OF_FOUR = ("near", "middle", "far", "aside", "near", "middle")
SIX = at("low", "near", "middle", "far", "near", "middle", "far")


PLANS = {
    "first pose: as many as a correction takes": (LANDMARKS, [], "low", (), (6, 6)),
    "later pose": (LANDMARKS, SIX, "high", (), (3, 3)),
    "done in this pose": (LANDMARKS, SIX, "low", (), (0, 0)),
    "a second pose makes up for the first": (LANDMARKS, at("low", "near", "far"), "high", (), (4, 4)),
    "pokes of this pose count": (LANDMARKS, at("low", *["near"] * 3), "low", (), (3, 6)),
    "never fewer than in another pose": (LANDMARKS, at("low", *["near"] * 5), "high", (), (3, 3)),
    "the same pose again": (LANDMARKS, [*SIX, *at("high", "near", "middle")], "high", (), (1, 3)),
    "no landmarks": ((), [], "low", (), (0, 0)),
    "one landmark": ((NEAR,), [], "low", (), (3, 3)),
    "a landmark that is gone counts": (LANDMARKS, at("low", "gone", "gone"), "low", (), (4, 6)),
    "all landmarks skipped": (LANDMARKS, [], "low", at("low", "near", "far", "middle"), (0, 0)),
    "the pose skipped": (LANDMARKS, at("high", "far"), "low", at("low", ""), (0, 0)),
    "another pose skipped": (LANDMARKS, [], "high", at("low", ""), (6, 6)),
}


@pytest.mark.parametrize("case", PLANS)
def test_how_many_landmarks_are_asked_for(case):
    *asked, (left, wanted) = PLANS[case]
    plan = landmark_targets(*asked)
    assert [(target.done, target.wanted, target.pokes_left) for target in plan] == [
        (done, wanted, wanted - done) for done in range(wanted - left, wanted)
    ]


@pytest.mark.usefixtures("needs_four")
@pytest.mark.parametrize(
    ("landmarks", "poked", "pose", "left"),
    [
        (FOUR, [], "low", 6),
        (FOUR, at("low", *SIX_OF_FOUR), "high", 3),
        (LANDMARKS, [], "low", 3),
        (LANDMARKS, at("low", "near", "far", "middle"), "high", 0),
        (LANDMARKS, at("low", "near", "far"), "high", 1),
    ],
)
def test_fewer_landmarks_than_a_correction_takes_are_poked_for_the_frame_alone(landmarks, poked, pose, left):
    assert len(landmark_targets(landmarks, poked, pose)) == left


def test_they_are_spread_over_the_part():
    plan = names(landmark_targets(LANDMARKS, [], "low"))
    assert plan[0] == "far", "the first is the farthest from the link's origin"
    assert plan[1] == "near", "farthest from the one before, though the middle one is farther from the origin"
    assert sorted(plan[:3]) == sorted(plan[3:]) == ["far", "middle", "near"], "each once before any twice"
    assert names(landmark_targets(LANDMARKS, [], "low", at("low", "far")))[:2] == ["middle", "near"]


@pytest.mark.parametrize(
    "poked",
    [
        pytest.param([*at("high", *["near"] * 5), *at("low", "far", "middle")], id="fewest in this pose"),
        pytest.param(at("high", "far", "far", "middle", "middle", "near"), id="fewest in all poses"),
    ],
)
def test_the_least_poked_goes_before_the_farthest(poked):
    assert landmark_targets(LANDMARKS, poked, "low")[0].landmark is NEAR


def touched(*channels):
    n = len(channels)
    return Contact(
        1, 0.0, 0.3, np.array([0, 0, -9.0]), np.zeros(3), np.array(channels, dtype=np.int64), np.full(n, 50.0),
        np.eye(4), "low", 0.05, True,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("channels", "there"),
    [((1,), True), ((2,), False), ((1, 2), True), ((2, 1), True), ((2, 3), False), ((9,), True), ((2, 9), False)],
)
def test_a_poke_was_there_unless_all_that_answered_lies_far_away(channels, there):
    aside = {1: 0.9 * LANDMARK_POKE_MAX_OFFSET_M, 2: 1.1 * LANDMARK_POKE_MAX_OFFSET_M, 3: 0.2}
    places = {channel: NEAR.place + np.array([0.0, y, 0.0]) for channel, y in aside.items()}
    assert may_be_at_landmark(touched(*channels), NEAR, places) is there
    assert may_be_at_landmark(touched(*channels), NEAR, {}), "no taxel's position is known"
    none = np.empty(0, dtype=np.int64)
    assert may_be_at_landmark(Rejection(1, 0.0, 0.3, Reason.NO_TAXEL, 0.0, 1.0, "", none, True), NEAR, {1: np.ones(3)})


def of_skin(**changes):
    """What a guide of the skin says of two taxels."""
    two = np.arange(2)
    made = Guidance(
        method=Method.FREE, phase=GuidePhase.SWEEP, target=None, channels=two, places=np.zeros((2, 3)), rms=np.zeros(2),
        diversity=np.zeros(2), own=two, needs=((), ()), given_up={}, usable_tilt=0.5, pokes_left=20, seconds_left=50.0,
    )  # fmt: skip
    return replace(made, **changes)


def test_a_landmark_goes_before_the_skin_and_the_rest_stays_as_it_is():
    skin, target, normal = of_skin(), LandmarkTarget(FAR, 2, 6), np.array([0.0, 0.6, 0.8])
    gain = Gain(0.0071, 0.0025, 4)
    asked = skin.before_skin(target, normal, gain)
    assert (asked.phase, asked.landmark, asked.gain) == (GuidePhase.LANDMARKS, target, gain)
    assert (asked.target.landmark, asked.target.channel, asked.target.tilt) == ("far", None, 0.0)
    np.testing.assert_array_equal(asked.target.place, FAR.place)
    np.testing.assert_array_equal(asked.target.normal, normal)
    np.testing.assert_array_equal(asked.target.push, -normal)
    assert asked.pokes_left == 24
    assert asked.seconds_left == pytest.approx(60.0), "at the pace of the skin"
    assert (asked.needs, asked.method, asked.finished) == (skin.needs, skin.method, 2)
    assert (skin.phase, skin.landmark, skin.pokes_left) == (GuidePhase.SWEEP, None, 20)


def test_without_a_pace_no_time_is_predicted():
    target = LandmarkTarget(FAR, 5, 6)
    assert of_skin(seconds_left=None).before_skin(target, np.array([1.0, 0, 0]), None).seconds_left is None
    enough = of_skin(pokes_left=0, seconds_left=0.0, phase=GuidePhase.ENOUGH).before_skin(target, np.array([1.0, 0, 0]), None)
    assert (enough.pokes_left, enough.seconds_left, enough.phase) == (1, 0.0, GuidePhase.LANDMARKS)


def bad_rig(errors, seed):
    """A rig, contacts of its first arm pose and six landmark pokes there."""
    rig, rng = make_rig(errors, seed), np.random.default_rng(seed)
    pose = next(iter(rig.arm_poses))
    contacts = [each for each in simulate_contacts(rig, unguided(rig, 1, rng), rng) if each.pose == pose]
    pokes = poke_landmarks(rig, rig.scene.landmarks, 6, rng, 5001)
    return rig, contacts, pokes[pokes.pose == pose][:6]


def test_a_rig_that_passes_its_landmarks_moves_the_estimates_and_the_tool_is_sent_where_the_skin_is():
    beside: dict[bool, list[float]] = {False: [], True: []}
    for seed in range(1, 7):
        rig, contacts, pokes = bad_rig(RigErrors.paper(), seed)
        scene, session = rig.scene, Session(rig.scene, rig.surface, (Method.SURFACE,))
        for contact in contacts[:12]:
            session.add(contact)
        found = {estimate.channel: estimate for estimate in session.snapshot().estimates[Method.SURFACE]}
        plan = plan_from_layout(scene.skin.layout, place_layout(scene.skin.layout, scene.skin.anchor, rig.surface))
        truth = np.array([rig.places[rig.row_of(int(channel))] for channel in plan.channels])
        for known, way in ((False, 0.0), (True, rig_error_sd(pokes, scene.noise))):
            places = believed_positions(plan, [found[int(channel)] for channel in plan.channels], way)
            beside[known].append(float(np.linalg.norm(places - truth, axis=1).mean()))
    assert np.mean(beside[False]) > 0.006
    assert np.mean(beside[True]) < 0.5 * np.mean(beside[False])
    assert max(beside[True]) < 0.008, "half a module"


def test_on_a_good_rig_next_to_nothing_is_the_rigs_and_one_wrong_poke_or_two_pokes_say_nothing():
    for seed in range(1, 7):
        rig, _, pokes = bad_rig(RigErrors.noise(), seed)
        assert rig_error_sd(pokes, rig.scene.noise) < 0.003
        wrong = replace(pokes, place=pokes.place[[3, 1, 2, 3, 4, 5]])
        assert rig_error_sd(wrong, rig.scene.noise) < 0.004
    bad = bad_rig(RigErrors.paper(), 1)[2]
    assert rig_error_sd(bad, rig.scene.noise) > 0.004
    assert rig_error_sd(bad[:2], rig.scene.noise) == 0.0

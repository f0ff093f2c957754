"""Which landmark is asked for next, which pokes may have been there, and the guidance that asks for one."""

from dataclasses import replace

import numpy as np
import pytest

from skincal.contacts.outcome import Contact, Reason, Rejection
from skincal.guide import guidance as landmarks_module
from skincal.guide.guidance import A_POSE, ASTRAY, Guidance, GuidePhase, LandmarkRound, LandmarkTarget, rig_moves, was_there
from skincal.guide.knowledge import believed, plan_from
from skincal.mesh.lay import lay
from skincal.model.scene import Landmark
from skincal.rig.expected_gain import Gain
from skincal.session.session import Session
from skincal.simulate.contacts import poke_landmarks, simulate_contacts, unguided
from skincal.simulate.faults import RigErrors
from skincal.taxels.result import Method
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
        monkeypatch.setattr(landmarks_module, "FEWEST_POINTS", 3)


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


def test_the_first_pose_gets_as_many_as_a_correction_takes_and_each_later_one_three():
    asked = LandmarkRound()
    first = asked.plan(LANDMARKS, [], "low")
    assert [(target.done, target.wanted, target.left) for target in first] == [(done, 6, 6 - done) for done in range(6)]
    later = asked.plan(LANDMARKS, SIX, "high")
    assert [(target.done, target.wanted) for target in later] == [(done, A_POSE) for done in range(3)]
    assert asked.plan(LANDMARKS, SIX, "low") == []


@pytest.mark.usefixtures("needs_four")
def test_fewer_landmarks_than_a_correction_takes_are_poked_for_the_frame_alone():
    assert [target.wanted for target in LandmarkRound().plan(FOUR, [], "low")] == [6] * 6
    assert [(target.done, target.wanted) for target in LandmarkRound().plan(LANDMARKS, [], "low")] == [(0, 3), (1, 3), (2, 3)]
    assert LandmarkRound().plan(LANDMARKS, at("low", "near", "far", "middle"), "high") == [], "the frame is the same there"
    assert [target.done for target in LandmarkRound().plan(LANDMARKS, at("low", "near", "far"), "high")] == [0]
    assert len(LandmarkRound().plan(FOUR, at("low", *SIX_OF_FOUR), "high")) == A_POSE


def test_a_second_pose_makes_up_for_what_the_first_left_out():
    targets = LandmarkRound().plan(LANDMARKS, at("low", "near", "far"), "high")
    assert [(target.done, target.wanted) for target in targets] == [(done, 4) for done in range(4)]
    assert LandmarkRound().next(LANDMARKS, at("low", *["near"] * 3), "low").wanted == 6, "those of this pose count"
    five = LandmarkRound().plan(LANDMARKS, at("low", *["near"] * 5), "high")
    assert len(five) == A_POSE, "never fewer than in any other pose"


def test_a_plan_is_what_is_asked_for_one_after_the_other():
    asked, poked, one_by_one = LandmarkRound(), at("low", "far"), []
    plan = asked.plan(LANDMARKS, poked, "low")
    while (target := asked.next(LANDMARKS, poked, "low")) is not None:
        one_by_one.append(target)
        poked.append(("low", target.landmark.name))
    assert names(plan) == names(one_by_one)
    assert [(target.done, target.wanted) for target in plan] == [(target.done, target.wanted) for target in one_by_one]
    assert len(plan) == 5


def test_they_are_spread_over_the_part():
    plan = names(LandmarkRound().plan(LANDMARKS, [], "low"))
    assert plan[0] == "far", "where nothing was poked, farthest from the link's origin"
    assert plan[1] == "near", "farthest from the one before, though the middle one is farther from the origin"
    assert sorted(plan[:3]) == sorted(plan[3:]) == ["far", "middle", "near"], "each once before any twice"


def test_the_least_poked_here_goes_before_the_least_poked_of_all_and_that_before_the_farthest():
    asked = LandmarkRound()
    # Here near has one less, although of all poses it has the most.
    poked = [*at("high", *["near"] * 5), *at("low", "far", "middle")]
    assert asked.next(LANDMARKS, poked, "low").landmark is NEAR
    # None of them was poked here: of all poses near has the fewest, though far lies farther away.
    poked = [*at("high", "far", "far", "middle", "middle", "near")]
    assert asked.next(LANDMARKS, poked, "low").landmark is NEAR


def test_one_that_is_skipped_is_asked_for_no_more_in_this_pose_alone():
    asked = LandmarkRound()
    asked.skip("far", "low")
    plan = asked.plan(LANDMARKS, [], "low")
    assert names(plan)[:2] == ["middle", "near"]
    assert sorted(names(plan)) == ["middle"] * 3 + ["near"] * 3
    assert "far" in names(asked.plan(LANDMARKS, [], "high"))
    for each in ("near", "middle"):
        asked.skip(each, "low")
    assert asked.plan(LANDMARKS, [], "low") == []


def test_a_pose_that_is_left_out_stays_so_on_return_and_no_other_is():
    asked = LandmarkRound()
    asked.leave_out("low")
    assert asked.plan(LANDMARKS, [], "low") == []
    assert len(asked.plan(LANDMARKS, [], "high")) == 6
    assert asked.plan(LANDMARKS, at("high", "far"), "low") == []


def test_in_a_pose_that_comes_again_what_was_poked_there_counts():
    asked = LandmarkRound()
    poked = [*SIX, *at("high", "near", "middle")]
    assert asked.next(LANDMARKS, poked, "low") is None
    (last,) = asked.plan(LANDMARKS, poked, "high")
    assert (last.landmark, last.done, last.wanted, last.left) == (FAR, 2, 3, 1)


def test_without_landmarks_none_is_asked_for_and_one_alone_is_poked_again():
    assert LandmarkRound().plan((), [], "low") == []
    assert LandmarkRound().next((), [], "low") is None
    assert names(LandmarkRound().plan((NEAR,), [], "low")) == ["near"] * A_POSE


def test_pokes_at_a_landmark_that_is_gone_count_and_lead_nowhere():
    poked = at("low", "gone", "gone")
    target = LandmarkRound().next(LANDMARKS, poked, "low")
    assert (target.landmark, target.done, target.wanted) == (FAR, 2, 6)


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
    aside = {1: 0.9 * ASTRAY, 2: 1.1 * ASTRAY, 3: 0.2}
    places = {channel: NEAR.place + np.array([0.0, y, 0.0]) for channel, y in aside.items()}
    assert was_there(touched(*channels), NEAR, places) is there
    assert was_there(touched(*channels), NEAR, {}), "where it is unknown where a taxel is, it may have been there"


def test_a_poke_that_no_taxel_answered_may_have_been_there():
    none = np.empty(0, dtype=np.int64)
    assert was_there(Rejection(1, 0.0, 0.3, Reason.NO_TAXEL, 0.0, 1.0, "", none, True), NEAR, {1: np.ones(3)})


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
    assert (asked.needs, asked.method, asked.done) == (skin.needs, skin.method, 2)
    assert (skin.phase, skin.landmark, skin.pokes_left) == (GuidePhase.SWEEP, None, 20)


def test_without_a_pace_no_time_is_predicted():
    target = LandmarkTarget(FAR, 5, 6)
    assert of_skin(seconds_left=None).before_skin(target, np.array([1.0, 0, 0]), None).seconds_left is None
    enough = of_skin(pokes_left=0, seconds_left=0.0, phase=GuidePhase.ENOUGH).before_skin(target, np.array([1.0, 0, 0]), None)
    assert (enough.pokes_left, enough.seconds_left, enough.phase) == (1, 0.0, GuidePhase.LANDMARKS)


def bad_rig(errors, seed):
    """A rig, contacts of its first arm pose and six landmark pokes there."""
    rig, rng = make_rig(errors, seed), np.random.default_rng(seed)
    pose = next(iter(rig.stances))
    contacts = [each for each in simulate_contacts(rig, unguided(rig, 1, rng), rng) if each.pose == pose]
    pokes = [each for each in poke_landmarks(rig, rig.scene.landmarks, 6, rng, 5001) if each.pose == pose]
    return rig, contacts, pokes[:6]


def test_a_rig_that_passes_its_landmarks_moves_the_estimates_and_the_tool_is_sent_where_the_skin_is():
    beside: dict[bool, list[float]] = {False: [], True: []}
    for seed in range(1, 7):
        rig, contacts, pokes = bad_rig(RigErrors.paper(), seed)
        scene, session = rig.scene, Session(rig.scene, rig.surface, (Method.SURFACE,))
        for contact in contacts[:12]:
            session.add(contact)
        found = {estimate.channel: estimate for estimate in session.snapshot().estimates[Method.SURFACE]}
        plan = plan_from(scene.skin.layout, lay(scene.skin.layout, scene.skin.anchor, rig.surface))
        truth = np.array([rig.places[rig.row_of(int(channel))] for channel in plan.channels])
        for known, way in ((False, 0.0), (True, rig_moves(pokes, scene.noise))):
            places = believed(plan, [found[int(channel)] for channel in plan.channels], way)
            beside[known].append(float(np.linalg.norm(places - truth, axis=1).mean()))
    assert np.mean(beside[False]) > 0.006
    assert np.mean(beside[True]) < 0.5 * np.mean(beside[False])
    assert max(beside[True]) < 0.008, "half a module"


def test_on_a_good_rig_next_to_nothing_is_the_rigs_and_one_wrong_poke_or_two_pokes_say_nothing():
    for seed in range(1, 7):
        rig, _, pokes = bad_rig(RigErrors.noise(), seed)
        assert rig_moves(pokes, rig.scene.noise) < 0.003
        wrong = [replace(pokes[0], place=pokes[3].place), *pokes[1:]]
        assert rig_moves(wrong, rig.scene.noise) < 0.004
    bad = bad_rig(RigErrors.paper(), 1)[2]
    assert rig_moves(bad, rig.scene.noise) > 0.004
    assert rig_moves(bad[:2], rig.scene.noise) == 0.0

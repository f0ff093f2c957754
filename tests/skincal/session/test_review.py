"""What another process tells of a session: only what is new goes there, and back comes what the session itself finds."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from skincal.contacts.outcome import Contact
from skincal.methods import estimate_taxels
from skincal.model.actions import AddLandmark, AtLandmark, Exclude, MarkDead, Uncorrect, Undo
from skincal.model.errors import InputError
from skincal.model.scene import SurfaceSpec
from skincal.rig.correction import FRAME, RIG, Correction
from skincal.rig.correction_fit import correct_rig
from skincal.rig.frame_check import diagnose
from skincal.session import review
from skincal.session.corrections import correct_action
from skincal.session.review import Asked, ReviewedPart, Reviewer, Unreviewed, review_change
from skincal.session.session import Session
from skincal.simulate.contacts import poke_landmarks, simulate_contacts, unguided
from skincal.simulate.faults import RigErrors
from skincal.words.rig_words import frame_sentence
from tests.approved import approved_pattern
from tests.skincal.poke_script import small_scene
from tests.skincal.session.test_corrections import rejected
from tests.skincal.sim_support import make_rig, scene_and_surface

FIRST = 5001
"""Number of the first landmark poke."""


@pytest.fixture(scope="module")
def poked():
    """A badly erring rig: pokes on two modules, and eight at landmarks, in one arm pose."""
    rig, rng = make_rig(RigErrors.paper(), 1), np.random.default_rng(8)
    contacts = simulate_contacts(rig, unguided(rig, 1, rng), rng)[:24]
    return rig, contacts, poke_landmarks(rig, rig.scene.landmarks, 8, rng, FIRST)[:8]


@pytest.fixture
def session(poked):
    rig, contacts, landmarks = poked
    made = Session(rig.scene, rig.surface)
    for contact in contacts:
        made.add(contact)
    for poke in landmarks:
        made.add(rejected(poke))
        made.act(AtLandmark(poke.poke, poke.name))
    return made


def rig_of(session):
    """A correction of the rig, whatever it is worth."""
    answer = correct_rig(session.rig_request())
    return correct_action(RIG, answer.correction, answer.before, answer.after, 8)


FRAME_ACTION = correct_action(FRAME, Correction(np.diag([1.0, 1.0, 1.0, 1e-3, 1e-3, 1e-3])), 0.05, 0.004, 8)


def framed(session):
    counting = [record.outcome.poke for record in session.snapshot().pokes if not record.excluded]
    return {outcome.poke: outcome for outcome in session.frame_corrected(counting)}


# What goes there


def test_the_first_time_all_is_new_and_then_nothing(session):
    asked = Asked()
    first = asked.change(session, session.snapshot())
    assert first.generation == 1
    assert first.pokes == framed(session)
    assert len(first.pokes) == 32
    assert (first.gone, first.corrected, first.dead) == ((), False, {})
    assert first.channels == session.channels
    second = asked.change(session, session.snapshot())
    assert (second.generation, second.pokes, second.gone) == (2, {}, ())


def test_only_a_poke_that_came_or_came_again_goes_there(session):
    asked = Asked()
    asked.change(session, session.snapshot())
    reported = session.outcome(3)
    session.add(replace(reported, poke=9000))
    change = asked.change(session, session.snapshot())
    assert list(change.pokes) == [9000]
    session.add(replace(reported, final=not reported.final))
    change = asked.change(session, session.snapshot())
    assert list(change.pokes) == [3]
    assert change.pokes[3] is session.outcome(3)


def test_a_poke_that_is_taken_out_is_told_as_gone_and_comes_back_by_undo(session):
    asked = Asked()
    asked.change(session, session.snapshot())
    session.act(Exclude(4))
    change = asked.change(session, session.snapshot())
    assert (change.pokes, change.gone) == ({}, (4,))
    assert (asked.change(session, session.snapshot()).gone) == ()
    session.act(Undo())
    change = asked.change(session, session.snapshot())
    assert (list(change.pokes), change.gone) == ([4], ())


def test_another_frame_makes_all_pokes_others_and_a_corrected_rig_none(session):
    asked = Asked()
    asked.change(session, session.snapshot())
    session.act(FRAME_ACTION)
    change = asked.change(session, session.snapshot())
    assert change.pokes.keys() == framed(session).keys()
    assert not change.corrected
    np.testing.assert_array_equal(change.pokes[3].moment, 1e-3 * session.outcome(3).moment)
    session.act(correct_action(RIG, Correction(1.01 * np.eye(6)), 0.01, 0.001, 8))
    change = asked.change(session, session.snapshot())
    assert change.corrected
    assert (change.pokes, change.gone) == ({}, ())
    session.act(Uncorrect(FRAME))
    change = asked.change(session, session.snapshot())
    assert len(change.pokes) == 32
    assert not change.corrected
    assert change.pokes[3] is session.outcome(3)


def test_which_poke_was_at_which_landmark_is_told_as_it_stands(session):
    asked = Asked()
    before = asked.change(session, session.snapshot())
    assert before.at_landmarks == session.snapshot().at_landmarks
    assert len(before.at_landmarks) == 8
    session.act(AddLandmark("screw", 0.01, 0.02, 0.03))
    session.act(AtLandmark(3, "screw"))
    session.act(MarkDead(session.channels[0]))
    change = asked.change(session, session.snapshot())
    assert change.pokes == {}
    assert change.at_landmarks == {**before.at_landmarks, 3: "screw"}
    assert change.landmarks[-1].name == "screw"
    assert list(change.dead) == [session.channels[0]]


def test_without_a_layout_a_channel_comes_with_its_first_poke():
    session, asked = Session(small_scene(layout=False), None), Asked()
    assert asked.change(session, session.snapshot()).channels == ()
    k = np.array([5])
    session.add(Contact(1, 0.0, 0.3, np.array([0, 0, -9.0]), np.zeros(3), k, np.ones(1), np.eye(4), "", 0.05, True))
    assert asked.change(session, session.snapshot()).channels == (5,)


# What comes back


def reviewed(session, reviewer=None, asked=None):
    reviewer = reviewer or Reviewer(session.scene, session.surface)
    reviewer.take((asked or Asked()).change(session, session.snapshot()))
    return reviewer.review(lambda: None)


def places(session, contacts):
    """Where each method puts the taxels, worked out without a reviewer; NaN where it does not know."""
    solved = estimate_taxels(
        contacts,
        session.channels,
        session.methods,
        session.scene.noise,
        session.surface,
        session.dead,
        model=session.module_model,
    )
    unknown = np.full(3, np.nan)
    return {
        method: np.array([unknown if estimate.position is None else estimate.position for estimate in found.values()])
        for method, found in solved.items()
    }


def assert_is_of(session, answer):
    """Fail unless a review says what the session itself finds."""
    normals = {landmark.name: landmark.normal for landmark in session.decisions.landmarks}
    frame = diagnose(session.landmark_pokes, [normals[poke.name] for poke in session.landmark_pokes])
    rig = correct_rig(session.rig_request())
    assert (answer.frame is None) == (frame is None)
    if frame is not None:
        assert frame_sentence(answer.frame) == frame_sentence(frame)
    assert [poke.poke for poke in answer.pokes] == [poke.poke for poke in session.landmark_pokes]
    assert (answer.rig.used, answer.rig.distances, answer.rig.trust) == (rig.used, rig.distances, rig.trust)
    np.testing.assert_array_equal(answer.rig.unknowns, rig.unknowns)
    np.testing.assert_array_equal(answer.channels, session.channels)
    contacts = [contact for contact in framed(session).values() if isinstance(contact, Contact)]
    corrected = RIG in session.decisions.corrections
    wanted = places(session, contacts) if corrected else {}
    offered = places(session, [rig.correction.corrected(contact) for contact in contacts]) if rig.used and not corrected else {}
    for found, expected in ((answer.before, wanted), (answer.after, offered)):
        assert found.keys() == expected.keys()
        for method, known in expected.items():
            np.testing.assert_array_equal(found[method], known)


def test_a_review_is_what_the_session_itself_finds(session):
    review = reviewed(session)
    assert review.rig.used
    assert review.generation == 1
    assert set(review.after) == set(session.methods)
    assert review.before == {}
    known = [np.isfinite(found).all(axis=1).sum() for found in review.after.values()]
    assert min(known) >= 10
    assert max(known) < len(session.channels), "what nobody poked is not known"
    assert_is_of(session, review)


def test_how_far_each_poke_passes_its_landmark_is_as_the_rig_tells(session):
    reported = reviewed(session).reported
    assert list(reported) == list(range(FIRST, FIRST + 8))
    for poke in session.landmark_pokes:
        # In the sensor's frame: a force along the axis has at the landmark the moment that is reported, less the arm's.
        where = np.linalg.solve(poke.link_from_sensor, np.append(poke.place, 1.0))[:3]
        along = poke.force / np.linalg.norm(poke.force)
        arm = poke.moment - np.cross(where, poke.force)
        miss = np.linalg.norm(arm - (arm @ along) * along) / np.linalg.norm(poke.force)
        assert reported[poke.poke] == pytest.approx(miss, abs=1e-9)


def test_a_reviewer_that_follows_says_the_same_as_one_that_is_told_all_at_once(session):
    reviewer, asked = Reviewer(session.scene, session.surface), Asked()
    for number, change in enumerate(
        (
            lambda: None,
            lambda: [session.act(Exclude(4)), session.act(AtLandmark(FIRST, ""))],
            lambda: [session.act(FRAME_ACTION), session.act(rig_of(session))],
            lambda: [session.act(Undo()) for _ in range(4)],
        ),
        1,
    ):
        change()
        review = reviewed(session, reviewer, asked)
        assert review.generation == number
        assert_is_of(session, review)
    assert len(review.pokes) == 8


def test_the_places_before_are_told_while_a_correction_is_in_use_and_those_after_while_none_is(session):
    session.act(rig_of(session))
    review = reviewed(session)
    assert review.after == {}
    assert set(review.before) == set(session.methods)
    assert_is_of(session, review)
    session.act(Undo())
    for method, found in review.before.items():
        now = session.snapshot().estimates[method]
        known = np.array([np.full(3, np.nan) if estimate.position is None else estimate.position for estimate in now])
        np.testing.assert_array_equal(found, known, err_msg="the session's own, without the correction")


def test_from_too_few_landmark_pokes_nothing_is_offered(poked):
    rig, contacts, landmarks = poked
    session = Session(rig.scene, rig.surface)
    for contact in contacts:
        session.add(contact)
    for poke in landmarks[:2]:
        session.add(rejected(poke))
        session.act(AtLandmark(poke.poke, poke.name))
    review = reviewed(session)
    assert review.frame is None
    assert review.rig.correction is None
    assert (review.before, review.after) == ({}, {})
    assert len(review.reported) == 2
    assert_is_of(session, review)


def test_a_reviewer_that_is_asked_nothing_says_nothing():
    with pytest.raises(ValueError, match="nothing was asked"):
        Reviewer(small_scene(), None).review(lambda: None)


class EnoughError(Exception):
    pass


def test_work_is_given_up_at_any_step_and_can_be_done_again(session):
    reviewer = Reviewer(session.scene, session.surface)
    reviewer.take(Asked().change(session, session.snapshot()))
    calls = []
    whole = reviewer.review(lambda: calls.append(1))
    assert len(calls) >= 4
    for step in (1, 2, len(calls)):
        left = iter(range(step - 1))

        def between(left=left):
            if next(left, None) is None:
                raise EnoughError

        with pytest.raises(EnoughError):
            reviewer.review(between)
    again = reviewer.review(lambda: None)
    np.testing.assert_array_equal(again.rig.unknowns, whole.rig.unknowns)


# In another process


def next_change(session, asked):
    """The words of a request for the session as it stands, as they arrive in the process."""
    change = asked.change(session, session.snapshot())
    part = None if change.since else part_of(session.scene, session.surface)
    return pickle.loads(pickle.dumps((part, change)))


def part_of(scene, surface):
    return ReviewedPart(scene, None if surface is None else surface.sha256)


def always():
    return True


def never():
    return False


@pytest.fixture(autouse=True)
def _of_nothing(monkeypatch):
    monkeypatch.setattr(review, "_reviewers", {})


def test_a_review_and_a_change_arrive_as_they_were_sent(session):
    change = Asked().change(session, session.snapshot())
    there = pickle.loads(pickle.dumps(change))
    assert there.at_landmarks == change.at_landmarks
    for number, poke in change.pokes.items():
        np.testing.assert_array_equal(there.pokes[number].force, poke.force)
    reviewer = Reviewer(session.scene, session.surface)
    reviewer.take(there)
    back = pickle.loads(pickle.dumps(reviewer.review(lambda: None)))
    assert_is_of(session, back)


def test_what_is_told_bit_by_bit_is_answered_as_the_session_stands(session):
    asked = Asked()
    assert_is_of(session, review_change("a", *next_change(session, asked), always))
    session.act(AtLandmark(FIRST, ""))
    second = review_change("a", *next_change(session, asked), always)
    assert second.generation == 2
    assert len(second.pokes) == 7
    assert_is_of(session, second)


def test_what_was_not_told_from_its_beginning_is_not_guessed(session):
    asked = Asked()
    first = next_change(session, asked)
    assert review_change("a", None, first[1], always) is Unreviewed.UNKNOWN, "a new process knows no part"
    review_change("a", *first, always)
    next_change(session, asked)
    session.act(Exclude(4))
    third = next_change(session, asked)
    assert review_change("a", *third, always) is Unreviewed.UNKNOWN, "the second never came"
    assert review_change("b", *third, always) is Unreviewed.UNKNOWN, "another session's"
    asked.forget()
    everything = next_change(session, asked)
    assert everything[1].generation == 4
    assert len(everything[1].pokes) == 31
    assert_is_of(session, review_change("a", *everything, always))
    assert list(review._reviewers) == ["a"]
    review_change("b", *next_change(session, Asked()), always)
    assert list(review._reviewers) == ["b"], "one session at a time"


@pytest.mark.parametrize("sha256", ["0" * 64, None])
def test_a_mesh_that_changed_is_said(sha256):
    with pytest.raises(InputError, match=approved_pattern("mesh.changed_after_opening")):
        ReviewedPart(scene_and_surface()[0], sha256).load_surface()


def test_a_mesh_that_is_gone_is_said(tmp_path):
    scene = small_scene()
    scene = replace(scene, surface=SurfaceSpec(tmp_path / "gone.ply", 1.0, np.eye(4)))
    with pytest.raises(InputError, match=r"gone\.ply"):
        ReviewedPart(scene, None).load_surface()


def test_a_part_without_a_mesh_needs_none():
    assert ReviewedPart(small_scene(), None).load_surface() is None
    scene, surface = scene_and_surface()
    assert part_of(scene, surface).load_surface().sha256 == surface.sha256


def test_work_gives_way_to_a_newer_change_and_what_it_was_told_is_kept(session, monkeypatch):
    asked = Asked()
    assert review_change("a", *next_change(session, asked), never) is Unreviewed.GIVEN_UP
    session.act(AtLandmark(FIRST, ""))
    steps = iter([True, True, False])
    assert review_change("a", *next_change(session, asked), lambda: next(steps)) is Unreviewed.GIVEN_UP, "in the middle"
    session.act(Exclude(4))
    assert_is_of(session, review_change("a", *next_change(session, asked), always))
    monkeypatch.setattr(review, "PATIENCE_S", 0.0)
    session.act(Undo())
    assert_is_of(session, review_change("a", *next_change(session, asked), never))

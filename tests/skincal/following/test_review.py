"""A review of landmark pokes is what the session itself finds, also from another process, and gives way to a newer one."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from skincal.contacts.outcome import Contact
from skincal.following import review
from skincal.following.review import ReviewRequest, review_packed, review_rig
from skincal.methods import estimate_taxels
from skincal.model.actions import AddLandmark, AtLandmark, Exclude, MarkDead, Undo
from skincal.model.errors import InputError
from skincal.model.scene import SurfaceSpec
from skincal.rig.correction import FRAME, RIG, Correction, UsedCorrection
from skincal.rig.correction_fit import correct_rig
from skincal.rig.frame_check import check_frame
from skincal.session.corrections import correct_action
from skincal.session.session import Session
from skincal.simulation.contacts import poke_landmarks, simulate_contacts, unguided
from skincal.simulation.rig_errors import RigErrors
from skincal.taxels.contact_table import ContactTable
from skincal.words.mistake_words import frame_sentence
from tests.approved import approved_pattern
from tests.build import session_of
from tests.skincal.poke_script import small_scene
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
    return session_of(contacts, rig.scene, rig.surface, landmarks)


def correct_rig_of(session):
    answer = correct_rig(session.rig_request())
    session.act(correct_action(UsedCorrection(RIG, answer.correction, answer.before, answer.after, 8)))


def change_frame(session):
    matrix = np.diag([1.0, 1.0, 1.0, 1e-3, 1e-3, 1e-3])
    session.act(correct_action(UsedCorrection(FRAME, Correction(matrix), 0.05, 0.004, 8)))


def places(session, contacts):
    """Where each method puts the taxels, by another route; NaN where it does not know."""
    solved = estimate_taxels(
        contacts, session.channels, session.methods, session.scene.noise, session.surface, session.dead,
        model=session.module_model,
    )  # fmt: skip
    unknown = np.full(3, np.nan)
    return {
        method: np.array([unknown if estimate.position is None else estimate.position for estimate in found.values()])
        for method, found in solved.items()
    }


def assert_is_of(session, answer):
    """Fail unless a review says what the session itself finds."""
    normals = {landmark.name: landmark.normal for landmark in session.decisions.landmarks}
    frame = check_frame(session.landmark_pokes, [normals[name] for name in session.landmark_pokes.name])
    rig = correct_rig(session.rig_request())
    assert (answer.frame and frame_sentence(answer.frame, has_arm=True)) == (frame and frame_sentence(frame, has_arm=True))
    assert answer.pokes.number.tolist() == list(answer.reported) == session.landmark_pokes.number.tolist()
    assert (answer.rig.used, answer.rig.distances, answer.rig.trust) == (rig.used, rig.distances, rig.trust)
    np.testing.assert_array_equal(answer.rig.unknowns, rig.unknowns)
    np.testing.assert_array_equal(answer.channels, session.channels)
    contacts = session.rig_request().contacts
    corrected = RIG in session.decisions.corrections
    wanted = places(session, contacts) if corrected else {}
    offered = places(session, [rig.correction.corrected(contact) for contact in contacts]) if rig.used and not corrected else {}
    for found, expected in ((answer.before, wanted), (answer.after, offered)):
        assert found.keys() == expected.keys()
        for method, known in expected.items():
            np.testing.assert_array_equal(found[method], known)


def sent(session):
    """A request as it arrives in the other process."""
    return pickle.loads(pickle.dumps(ReviewRequest.from_session(session).packed()))


CHANGES = {
    "as it is": lambda _: None,
    "pokes are taken out": lambda session: [session.act(Exclude(4)), session.act(AtLandmark(FIRST, ""))],
    "another landmark": lambda session: [
        session.act(AddLandmark("screw", 0.01, 0.02, 0.03)),
        session.act(AtLandmark(3, "screw")),
    ],
    "a dead channel": lambda session: session.act(MarkDead(session.channels[0])),
    "another frame": change_frame,
    "a corrected rig": correct_rig_of,
    "a corrected rig in another frame": lambda session: [change_frame(session), correct_rig_of(session)],
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_review_is_what_the_session_itself_finds_here_and_in_another_process(session, change):
    CHANGES[change](session)
    here = review_rig(ReviewRequest.from_session(session))
    assert here.used is session.decisions.corrections
    assert_is_of(session, here)
    assert_is_of(session, pickle.loads(pickle.dumps(review_packed(sent(session), lambda: True))))


def test_places_before_come_with_a_correction_in_use_and_those_after_without_one(session):
    offered = review_rig(ReviewRequest.from_session(session))
    assert (offered.rig.used, offered.before, set(offered.after)) == (True, {}, set(session.methods))
    known = [np.isfinite(found).all(axis=1).sum() for found in offered.after.values()]
    assert 10 <= min(known) <= max(known) < len(session.channels), "an unpoked taxel stays unknown"
    correct_rig_of(session)
    used = review_rig(ReviewRequest.from_session(session))
    assert (used.after, set(used.before)) == ({}, set(session.methods))
    session.act(Undo())
    for method, found in used.before.items():
        now = session.snapshot().estimates[method]
        plain = np.array([np.full(3, np.nan) if estimate.position is None else estimate.position for estimate in now])
        np.testing.assert_array_equal(found, plain, err_msg="the session's own, without the correction")


def test_the_reported_miss_is_the_distance_in_the_sensors_frame(session):
    reported = review_rig(ReviewRequest.from_session(session)).reported
    for poke in session.landmark_pokes:
        where = np.linalg.solve(poke.link_from_sensor, np.append(poke.place, 1.0))[:3]
        along = poke.force / np.linalg.norm(poke.force)
        arm = poke.moment - np.cross(where, poke.force)
        miss = np.linalg.norm(arm - (arm @ along) * along) / np.linalg.norm(poke.force)
        assert reported[int(poke.number)] == pytest.approx(miss, abs=1e-9)


def test_too_few_landmark_pokes_offer_nothing(poked):
    rig, contacts, landmarks = poked
    session = session_of(contacts, rig.scene, rig.surface, landmarks[:2])
    found = review_rig(ReviewRequest.from_session(session))
    assert (found.frame, found.rig.correction, found.before, found.after, len(found.reported)) == (None, None, {}, {}, 2)
    assert_is_of(session, found)


def test_every_bit_of_a_contact_arrives(session):
    session.add(replace(session.outcome(3), poke=9000, pose="another", final=True))
    there = sent(session)
    for one, other in zip(session.rig_request().contacts, there.contacts, strict=True):
        assert (one.poke, one.pose, one.start_s, one.end_s) == (other.poke, other.pose, other.start_s, other.end_s)
        for name in ("force", "moment", "channels", "responses", "link_from_sensor"):
            first, second = getattr(one, name), getattr(other, name)
            assert (first.dtype, first.tobytes()) == (second.dtype, second.tobytes())
    assert isinstance(there.contacts[-1], Contact)
    empty = replace(there, contacts=()).packed()
    assert list(pickle.loads(pickle.dumps(empty)).contacts) == []


def test_answers_at_the_end_of_the_range_are_known_in_the_other_process(poked):
    """They were lost on the way: there each of two counted by its reading."""
    rig, contacts, landmarks = poked
    several = next(contact for contact in contacts if len(contact.channels) > 2)
    clipped = [replace(each, clipped=each.channels[:2]) if each is several else each for each in contacts]
    request = sent(session_of(clipped, rig.scene, rig.surface, landmarks))
    found = {contact.poke: contact.clipped for contact in request.contacts}
    assert found.pop(several.poke).tolist() == several.channels[:2].tolist()
    assert set(found.values()) == {None}
    there = ContactTable(request.contacts).evidence(several.channels.tolist())
    assert np.array_equal(there.unranked, ContactTable(clipped).evidence(several.channels.tolist()).unranked)
    assert there.unranked.sum() == 2


def test_a_mesh_that_changed_or_is_gone_is_said_and_a_part_without_one_needs_none(session, tmp_path):
    review._load_part.cache_clear()
    there = sent(session)
    for sha256 in ("0" * 64, None):
        with pytest.raises(InputError, match=approved_pattern("mesh.changed_after_opening")):
            replace(there, mesh_sha256=sha256).load_part()
    scene, surface = scene_and_surface()
    assert there.load_part()[0].sha256 == surface.sha256
    assert sent(session).load_part() is there.load_part(), "read once"
    plain = ReviewRequest.from_session(Session(small_scene(), None)).packed()
    assert plain.load_part()[0] is None
    gone = replace(scene, surface=SurfaceSpec(tmp_path / "gone.ply", 1.0, np.eye(4)))
    with pytest.raises(InputError, match=r"gone\.ply"):
        ReviewRequest.from_session(Session(gone, None)).packed().load_part()


def test_a_part_is_read_once_whatever_is_read_of_its_layout_or_changed_elsewhere_in_its_scene(session):
    request, scene = sent(session), session.scene
    layout = scene.skin.layout.with_modules(scene.skin.layout.modules)
    there = replace(request, scene=replace(scene, skin=replace(scene.skin, layout=layout)))
    part = there.load_part()
    assert layout.spacing > 0.0
    assert there.load_part() is part
    other = replace(there.scene, landmarks=(), contacts=replace(scene.contacts, force_min=5.0))
    assert replace(there, scene=other).load_part() is part
    assert replace(there, scene=replace(there.scene, skin=replace(there.scene.skin, anchor=None))).load_part() is not part


def test_work_gives_way_to_a_newer_request_unless_it_took_long(session, monkeypatch):
    assert review_packed(sent(session), lambda: False) is None
    steps = iter([True, True, False])
    assert review_packed(sent(session), lambda: next(steps)) is None, "in the middle"
    monkeypatch.setattr(review, "FINISH_REVIEW_IF_RUNNING_FOR_S", 0.0)
    assert_is_of(session, review_packed(sent(session), lambda: False))

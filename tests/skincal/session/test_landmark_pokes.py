"""Pokes at landmarks: kept by the session, taken back, journalled and played again, and handed to the rig's correction."""

import json
from dataclasses import replace

import numpy as np
import pytest

from skincal.cli import main
from skincal.contacts.outcome import Contact, Reason, Rejection
from skincal.journal.writer import create_session
from skincal.model.actions import AddLandmark, AtLandmark, Exclude, Undo, from_json, to_json
from skincal.model.errors import InputError
from skincal.model.readings import Chunk
from skincal.model.scene import Landmark, load_scene, resource
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load, replay
from skincal.session.session import Session
from skincal.simulate.contacts import poke_landmarks, simulate_contacts, unguided
from skincal.simulate.faults import RigErrors
from tests.approved import approved, approved_pattern
from tests.skincal.poke_script import LINKS, Script, as_chunks, same_estimates, small_scene, write_scene
from tests.skincal.sim_support import make_rig

FORCE, POINT = np.array([1.0, 2.0, -8.0]), np.array([0.02, 0.05, 0.10])
HEAD = Landmark("head", POINT, None)


def bytes_of(scene, answers):
    """Pokes at one point, each answered as asked."""
    script = Script(scene).quiet()
    for answer in answers:
        script.press(FORCE, POINT, answer).quiet()
    return as_chunks(script.samples)


def pipeline_of(scene, answers=({}, {3: 80.0}), journal=None):
    pipeline = Pipeline(scene, LINKS, None, journal)
    for item in bytes_of(scene, answers):
        pipeline.feed(item)
    return pipeline


def test_a_poke_that_no_taxel_answered_may_be_at_a_landmark():
    scene = replace(small_scene(), landmarks=(HEAD,))
    session = pipeline_of(scene).session
    first, second = (record.outcome for record in session.snapshot().pokes)
    assert isinstance(first, Rejection)
    assert first.reason is Reason.NO_TAXEL
    assert isinstance(second, Contact)
    assert session.landmark_pokes == ()
    for poke in (first.poke, second.poke):
        session.act(AtLandmark(poke, "head"))
    reported = session.landmark_pokes
    assert [each.poke for each in reported] == [1, 2]
    np.testing.assert_allclose(reported[0].force, FORCE, atol=2e-6)
    np.testing.assert_allclose(reported[0].moment, np.cross(POINT, FORCE), atol=2e-6)
    assert (reported[0].place == POINT).all()
    assert session.snapshot().at_landmarks == {1: "head", 2: "head"}
    assert session.snapshot().can_undo == approved("landmark.undo_poke", poke=2, name="head")
    session.act(Undo())
    session.act(AtLandmark(1, ""))
    assert session.landmark_pokes == ()
    session.act(Undo())
    assert [each.poke for each in session.landmark_pokes] == [1]
    session.act(AtLandmark(2, "head"))
    session.act(Exclude(2))
    assert [each.poke for each in session.landmark_pokes] == [1]


def test_landmarks_are_added_by_hand_and_named_once():
    session = Session(small_scene(), None)
    with pytest.raises(InputError, match="the scene has none"):
        session.act(AtLandmark(1, "head"))
    with pytest.raises(InputError, match=approved_pattern("landmark.wrong_contact")):
        session.act(AtLandmark(999, ""))
    assert session.snapshot().can_undo == ""
    session.act(AddLandmark("head", 0.02, 0.05, 0.10))
    assert [landmark.name for landmark in session.snapshot().decisions.landmarks] == ["head"]
    for wrong in (AddLandmark("head", 0.0, 0.0, 0.0), AddLandmark("", 0.0, 0.0, 0.0), AddLandmark("far", 20.0, 0.0, 0.0)):
        with pytest.raises(InputError):
            session.act(wrong)
    with pytest.raises(InputError, match=approved_pattern("landmark.wrong_contact")):
        session.act(AtLandmark(7, "head"))
    session.act(Undo())
    assert session.decisions.landmarks == ()


@pytest.mark.parametrize("action", [AddLandmark("a b", 0.1, -0.2, 1e-3), AtLandmark(3, "a b"), AtLandmark(3, "")])
def test_actions_travel_as_json(action):
    assert from_json(json.loads(json.dumps(to_json(action)))) == action


@pytest.mark.parametrize("again", [replay, load])
def test_a_session_played_again_has_the_same_landmark_pokes(tmp_path, again):
    scene = write_scene(tmp_path / "source")
    pipeline = Pipeline(scene, LINKS, None, create_session(tmp_path / "s", scene, LINKS))
    items = bytes_of(scene, ({}, {3: 80.0}))
    for item in items:
        pipeline.feed(item)
    last = max(item.host_ns for item in items if isinstance(item, Chunk))
    pipeline.act(AddLandmark("head", *POINT.tolist()), last + 1)
    pipeline.act(AtLandmark(1, "head"), last + 2)
    pipeline.close()
    other = again(tmp_path / "s")
    assert same_estimates(other.snapshot(), pipeline.snapshot())
    (here,), (there,) = pipeline.session.landmark_pokes, other.session.landmark_pokes
    assert (here.poke, here.name, here.pose) == (there.poke, there.name, there.pose)
    assert here.force.tobytes() == there.force.tobytes()
    assert here.place.tobytes() == there.place.tobytes()


def test_scenes_name_landmarks_and_say_what_is_wrong_with_them(tmp_path):
    scene = load_scene(resource("scenes/flat-patch/scene.toml"))
    assert scene.landmarks == ()
    text = (resource("scenes/flat-patch/scene.toml")).read_text(encoding="utf-8")
    (tmp_path / "modules.toml").write_bytes(resource("scenes/flat-patch/modules.toml").read_bytes())
    good = '\n[[landmarks]]\nname = "corner"\nplace = [0.03, 0.03, 0.0]\nnormal = [0, 0, 2]\n'
    path = tmp_path / "scene.toml"
    path.write_text(text + good + '\n[[landmarks]]\nname = "other"\nplace = [0.03, -0.03, 0.0]\n', encoding="utf-8")
    one, other = load_scene(path).landmarks
    assert one.normal.tolist() == [0.0, 0.0, 1.0]
    assert other.normal is None
    for wrong, why in (
        (good + good, approved("landmark.name_twice")),
        (good.replace("0.03, 0.03", "30, 30"), "divide millimetres"),
    ):
        path.write_text(text + wrong, encoding="utf-8")
        with pytest.raises(InputError, match=why):
            load_scene(path)


def test_a_session_asks_for_what_corrects_its_rig(rng):
    rig = make_rig(RigErrors.paper(), 1)
    session = Session(rig.scene, rig.surface)
    for contact in simulate_contacts(rig, unguided(rig, 1, rng), rng):
        session.add(contact)
    for poke in poke_landmarks(rig, rig.scene.landmarks, 3, rng, 1001)[:6]:
        nobody = np.empty(0, dtype=np.int64)
        session.add(
            Rejection(
                poke.poke, 0.0, 0.3, Reason.NO_TAXEL, 0.0, 1.0, "", nobody, True, poke.force, poke.moment,
                poke.link_from_sensor, poke.pose,
            )
        )  # fmt: skip
        session.act(AtLandmark(poke.poke, poke.name))
    request = session.rig_request()
    assert [poke.poke for poke in request.landmarks] == list(range(1001, 1007))
    assert {poke.pose for poke in request.landmarks} == {"1", "2"}
    assert len(request.contacts) == len(session.contacts)


def test_solve_reports_what_landmarks_tell(tmp_path, capsys):
    scene = write_scene(tmp_path / "source")
    pipeline = Pipeline(scene, LINKS, None, create_session(tmp_path / "s", scene, LINKS))
    items = bytes_of(scene, ({}, {3: 80.0}, {}, {}))
    for item in items:
        pipeline.feed(item)
    last = max(item.host_ns for item in items if isinstance(item, Chunk))
    pipeline.act(AddLandmark("head", *POINT.tolist()), last + 1)
    for poke in (1, 3, 4):
        pipeline.act(AtLandmark(poke, "head"), last + 1 + poke)
    pipeline.close()
    assert main(["solve", str(tmp_path / "s"), "--json"]) == 0
    rig = json.loads(capsys.readouterr().out)["rig"]
    assert rig["landmark_pokes"] == 3
    assert rig["used"] is False
    assert rig["frame"]["right"]
    assert main(["solve", str(tmp_path / "s")]) == 0
    reported = capsys.readouterr().out
    assert "frame looks right" in reported
    needs = approved("rig.pokes_needed", pokes=6, landmarks=4)
    assert approved("rig.too_few", needs=needs, pokes=3, landmarks=1) in reported

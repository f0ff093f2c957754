"""Pokes at landmarks: named by hand, or asked for and found by the pipeline, by `record` and by a replay."""

from __future__ import annotations

import json
import threading
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from skincal.cli import main
from skincal.cli.record import OrderLine, _loop
from skincal.contacts.outcome import Contact, Reason, Rejection
from skincal.contacts.poke_columns import PokeColumns
from skincal.following.session_guide import changes_pose_at_most_pokes
from skincal.journal.reader import SessionLog
from skincal.journal.writer import create_session
from skincal.model.actions import (
    AddLandmark,
    AskLandmark,
    AtLandmark,
    Exclude,
    FoundAtLandmark,
    MissedLandmark,
    TimedAction,
    Undo,
    action_to_json,
)
from skincal.model.errors import InputError
from skincal.model.readings import Chunk
from skincal.model.scene import Landmark, load_scene, resource
from skincal.session.landmark_pokes import VISUAL_REACTION_TIME_S
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load, replay
from skincal.streams.links import ChunkQueue
from skincal.words.poke_words import missed_words
from tests.approved import approved
from tests.build import rejection
from tests.skincal.poke_script import LINKS, Script, as_chunks, outcome_key, same_estimates, small_scene, write_scene

FORCE, POINT = np.array([1.0, 2.0, -8.0]), np.array([0.02, 0.05, 0.10])
HEAD, TAIL = Landmark("head", POINT, None), Landmark("tail", POINT + 0.01, None)
FAR = POINT + np.array([0.0, -0.09, 0.0])


def bytes_of(scene, answers=({}, {3: 80.0}, {}), places=None):
    """Pokes, each answered as asked, at one point or at `places`."""
    script = Script(scene).quiet()
    for place, answer in zip(places or [POINT] * len(answers), answers, strict=True):
        script.press(FORCE, place, answer).quiet()
    return as_chunks(script.samples)


def starts_of(scene, items):
    """When each poke begins, host's monotonic clock, nanoseconds."""
    return [round(record.outcome.start_s * 1e9) for record in fed(scene, items).snapshot().pokes]


def fed(scene, items, orders=(), journal=None):
    """Feed bytes, and do each order at its time."""
    pipeline, waiting = Pipeline(scene, LINKS, None, journal), sorted(orders, key=lambda order: order.host_ns)
    for item in items:
        while waiting and waiting[0].host_ns <= item.host_ns:
            order = waiting.pop(0)
            pipeline.act(order.action, order.host_ns)
        pipeline.feed(item)
    return pipeline


def ask_head_throughout(scene, places):
    """Bytes of pokes at these places, and the order that asks for the head before the first."""
    items = bytes_of(scene, [{}] * len(places), places)
    return items, [TimedAction(starts_of(scene, items)[0] - 500_000_000, AskLandmark("head"))]


@pytest.fixture
def scene():
    return replace(small_scene(), landmarks=(HEAD, TAIL))


@pytest.fixture
def stored(tmp_path):
    """The same scene in a file."""
    path = write_scene(tmp_path / "source").path
    with path.open("a", encoding="utf-8") as file:
        for landmark in (HEAD, TAIL):
            file.write(f'\n[[landmarks]]\nname = "{landmark.name}"\nplace = {landmark.place.tolist()}\n')
    return load_scene(path)


def test_a_poke_is_named_by_hand_whether_a_taxel_answered_or_not(scene):
    session = fed(scene, bytes_of(scene, ({}, {3: 80.0}))).session
    first, second = (record.outcome for record in session.snapshot().pokes)
    assert isinstance(first, Rejection)
    assert first.reason is Reason.NO_TAXEL
    assert isinstance(second, Contact)
    assert not len(session.landmark_pokes)
    for poke in (1, 2):
        session.act(AtLandmark(poke, "head"))
    reported = session.landmark_pokes
    np.testing.assert_allclose(reported[0].force, FORCE, atol=2e-6)
    np.testing.assert_allclose(reported[0].moment, np.cross(POINT, FORCE), atol=2e-6)
    assert (reported[0].place == POINT).all()
    assert session.snapshot().at_landmarks == {1: "head", 2: "head"}
    assert session.rig_request().landmarks.number.tolist() == [1, 2]
    assert session.snapshot().can_undo == approved("landmark.undo_poke", poke=2, name="head")

    def known():
        return session.landmark_pokes.number.tolist()

    for action, wanted in (
        (Undo(), [1]),
        (AtLandmark(1, ""), []),
        (Undo(), [1]),
        (AtLandmark(2, "head"), [1, 2]),
        (Exclude(2), [1]),
    ):
        session.act(action)
        assert known() == wanted


def test_scenes_name_landmarks_and_say_what_is_wrong_with_them(tmp_path):
    text = (resource("scenes/flat-patch/scene.toml")).read_text(encoding="utf-8")
    (tmp_path / "modules.toml").write_bytes(resource("scenes/flat-patch/modules.toml").read_bytes())
    good = '\n[[landmarks]]\nname = "corner"\nplace = [0.03, 0.03, 0.0]\nnormal = [0, 0, 2]\n'
    path = tmp_path / "scene.toml"
    path.write_text(text + good + '\n[[landmarks]]\nname = "other"\nplace = [0.03, -0.03, 0.0]\n', encoding="utf-8")
    one, other = load_scene(path).landmarks
    assert (one.normal.tolist(), other.normal) == ([0.0, 0.0, 1.0], None)
    for wrong, why in (
        (good + good, approved("landmark.name_twice")),
        (good.replace("0.03, 0.03", "30, 30"), "divide millimetres"),
    ):
        path.write_text(text + wrong, encoding="utf-8")
        with pytest.raises(InputError, match=why):
            load_scene(path)


def test_a_poke_after_the_request_is_at_the_landmark_whether_a_taxel_answers_or_not(scene):
    items = bytes_of(scene)
    _, second, third = starts_of(scene, items)
    snapshot = fed(scene, items, [TimedAction(second - 500_000_000, AskLandmark("head"))]).snapshot()
    assert [type(record.outcome) for record in snapshot.pokes] == [Rejection, Contact, Rejection]
    assert snapshot.at_landmarks == {2: "head", 3: "head"}
    assert snapshot.can_undo == approved("landmark.undo_poke", poke=3, name="head")
    # A poke that was on its way is not at it, and none is once nothing is asked for.
    late = TimedAction(second - round(VISUAL_REACTION_TIME_S * 0.9e9), AskLandmark("tail"))
    assert fed(scene, items, [late]).snapshot().at_landmarks == {3: "tail"}
    ended = TimedAction(third - 300_000_000, AskLandmark(""))
    assert fed(scene, items, [late, ended]).snapshot().at_landmarks == {}


def test_a_request_changes_nothing_that_is_known_and_ends_with_its_segment(scene):
    pipeline = Pipeline(scene, LINKS, None)
    before = pipeline.snapshot()
    pipeline.act(AskLandmark("head"), 2)
    assert pipeline.asked_landmark == "head"
    assert pipeline.snapshot() is before
    with pytest.raises(InputError, match="nothing to undo"):
        pipeline.act(Undo(), 3)
    pipeline.begin_segment()
    assert pipeline.asked_landmark == ""


def test_record_and_a_replay_make_the_same_of_the_same_bytes_and_orders(stored, tmp_path, capsys):
    items = bytes_of(stored)
    first, _, third = starts_of(stored, items)
    orders = [
        TimedAction(first - 500_000_000, AskLandmark("head")),
        TimedAction(third - 700_000_000, Undo()),
        TimedAction(third - 600_000_000, AskLandmark("tail")),
    ]
    folder = tmp_path / "s"
    live = fed(stored, items, orders, create_session(folder, stored, LINKS))
    live.close()
    assert live.snapshot().at_landmarks == {1: "head", 3: "tail"}
    items, plain = ChunkQueue(), Pipeline(stored, LINKS, None)
    for item in SessionLog(folder).items():
        if isinstance(item, Chunk):
            plain.feed(item)
        if isinstance(item, TimedAction):
            if not isinstance(item.action, FoundAtLandmark | MissedLandmark):
                items.put(OrderLine(item.host_ns, json.dumps(action_to_json(item.action)).encode()))
        elif hasattr(item, "link"):
            items.put(item)
    assert plain.snapshot().at_landmarks == {}, "without the orders"
    items.put(OrderLine(10**18, b'{"do": "ask_landmark", "name": "nose"}\n'))
    items.put(OrderLine(10**18, b"poke 3\n"))
    headless = Pipeline(stored, LINKS, None)
    _loop(headless, items, {}, (None, None), threading.Event())
    said = capsys.readouterr().err
    assert approved("landmark.order_refused", order='{"do": "ask_landmark", "name": "nose"}') in said
    assert approved("landmark.poke_order_refused", channel=3) in said
    for other in (headless, replay(folder), load(folder)):
        assert (other.findings, other.snapshot().at_landmarks) == ((), live.snapshot().at_landmarks)
        assert other.snapshot().can_undo == approved("landmark.undo_poke", poke=3, name="tail")
        mine, theirs = ([outcome_key(poke.outcome) for poke in each.snapshot().pokes] for each in (other, live))
        assert mine == theirs
        assert same_estimates(other.snapshot(), live.snapshot())


def test_a_poke_far_from_the_landmark_is_a_rejection_with_its_number(scene, capsys):
    items, orders = ask_head_throughout(scene, (POINT, FAR, POINT))
    queued, pipeline = ChunkQueue(), Pipeline(scene, LINKS, None)
    queued.put(OrderLine(orders[0].host_ns, json.dumps(action_to_json(orders[0].action)).encode()))
    for item in items:
        queued.put(item)
    _loop(pipeline, queued, {}, (None, None), threading.Event())
    snapshot = pipeline.snapshot()
    assert snapshot.at_landmarks == {1: "head", 3: "head"}
    (missed,) = snapshot.decisions.missed_landmarks.values()
    assert (missed.poke, missed.name) == (2, "head")
    across = np.linalg.norm(np.cross(FAR - POINT, FORCE / np.linalg.norm(FORCE)))
    assert missed.miss == pytest.approx(across, abs=1e-6)
    assert 0.01 < missed.limit < missed.miss
    said = approved("landmark.missed", name="head", seen=f"{missed.miss * 1e3:.0f}", most=f"{missed.limit * 1e3:.0f}")
    assert f"poke 2: {said}\n" in capsys.readouterr().err
    assert snapshot.can_undo == approved("landmark.undo_poke", poke=3, name="head"), "it is no step of its own"
    pipeline.act(AtLandmark(2, "head"), 10**18)
    assert pipeline.snapshot().at_landmarks == dict.fromkeys((1, 2, 3), "head")
    assert pipeline.snapshot().decisions.missed_landmarks == {}, "the operator knows better"


@pytest.mark.parametrize(
    ("places", "found", "missed"),
    [
        ((FAR, FAR, FAR), (1, 2, 3), ()),  # a wrong frame, which these pokes show
        ((FAR, POINT, POINT), (2, 3), (1,)),
        ((FAR, POINT, POINT, FAR), (2, 3), (1, 4)),
    ],
)
@pytest.mark.parametrize("again", [replay, load])
def test_the_majority_decides_and_a_replay_agrees(stored, tmp_path, places, found, missed, again):
    pipeline = fed(stored, *ask_head_throughout(stored, places), create_session(tmp_path / "s", stored, LINKS))
    pipeline.close()
    other = again(tmp_path / "s")
    for each in (pipeline, other):
        assert each.snapshot().at_landmarks == dict.fromkeys(found, "head")
        assert tuple(each.snapshot().decisions.missed_landmarks) == missed
    assert other.snapshot().decisions.missed_landmarks == pipeline.snapshot().decisions.missed_landmarks


def test_a_push_from_another_side_is_not_at_a_landmark_however_near_its_axis_passes(scene):
    push = FORCE / np.linalg.norm(FORCE)
    front, back = Landmark("front", POINT, -push), Landmark("back", POINT + 0.05 * push, push)
    scene = replace(scene, landmarks=(front, back))
    items = bytes_of(scene, ({}, {}))
    first, second = starts_of(scene, items)
    orders = [TimedAction(first - 500_000_000, AskLandmark("front")), TimedAction(second - 500_000_000, AskLandmark("back"))]
    snapshot = fed(scene, items, orders).snapshot()
    assert snapshot.at_landmarks == {1: "front"}
    missed = snapshot.decisions.missed_landmarks[2]
    assert missed.behind
    assert missed.miss < missed.limit
    assert missed_words(missed) == approved("landmark.behind", name="back")


def test_solve_reports_what_landmarks_tell(tmp_path, capsys):
    scene = write_scene(tmp_path / "source")
    pipeline = fed(scene, bytes_of(scene, ({}, {3: 80.0}, {}, {})), (), create_session(tmp_path / "s", scene, LINKS))
    pipeline.act(AddLandmark("head", *POINT.tolist()), 10**18)
    for poke in (1, 3, 4):
        pipeline.act(AtLandmark(poke, "head"), 10**18 + poke)
    pipeline.close()
    assert main(["solve", str(tmp_path / "s"), "--json"]) == 0
    rig = json.loads(capsys.readouterr().out)["rig"]
    assert (rig["landmark_pokes"], rig["used"], rig["frame"]["right"]) == (3, False, True)
    assert main(["solve", str(tmp_path / "s")]) == 0
    reported = capsys.readouterr().out
    assert "frame looks right" in reported
    needs = approved("rig.pokes_needed", pokes=6, landmarks=4)
    assert approved("rig.too_few", needs=needs, pokes=3, landmarks=1) in reported


@pytest.mark.parametrize(("poses", "changes"), [("", False), ("ab", False), ("aabba", False), ("abc", True), ("abab", True)])
def test_an_arm_that_carries_the_part_changes_its_pose_at_most_pokes(poses, changes):
    columns = PokeColumns.collect((replace(rejection(number), pose=pose), False) for number, pose in enumerate(poses, start=1))
    snapshot = SimpleNamespace(columns=columns)
    assert changes_pose_at_most_pokes(snapshot) is changes

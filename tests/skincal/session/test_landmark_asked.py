"""A landmark is asked for, and the poke that follows is found to be there: by the pipeline, by `record`, and by a replay."""

from __future__ import annotations

import json
import queue
import threading
from dataclasses import replace

import numpy as np
import pytest

from skincal.cli.record import OrderLine, _loop
from skincal.contacts.outcome import Contact, Rejection
from skincal.journal.reader import SessionLog
from skincal.journal.writer import create_session
from skincal.model.actions import AskLandmark, AtLandmark, FoundAtLandmark, MissedLandmark, Stamped, Undo, from_json, to_json
from skincal.model.errors import InputError
from skincal.model.readings import Chunk
from skincal.model.scene import Landmark, load_scene
from skincal.session.landmark_pokes import REACTION_S
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load, replay
from skincal.words.poke_words import missed_words
from tests.approved import approved
from tests.skincal.poke_script import LINKS, Script, as_chunks, outcome_key, same_estimates, small_scene, write_scene

FORCE, POINT = np.array([1.0, 2.0, -8.0]), np.array([0.02, 0.05, 0.10])
HEAD, TAIL = Landmark("head", POINT, None), Landmark("tail", POINT + 0.01, None)


def bytes_of(scene, answers=({}, {3: 80.0}, {})):
    """Pokes at one point, each answered as asked."""
    script = Script(scene).quiet()
    for answer in answers:
        script.press(FORCE, POINT, answer).quiet()
    return as_chunks(script.samples)


def starts_of(scene, items):
    """When each poke begins, host's monotonic clock, nanoseconds."""
    pipeline = Pipeline(scene, LINKS, None)
    for item in items:
        pipeline.feed(item)
    return [round(record.outcome.start_s * 1e9) for record in pipeline.snapshot().pokes]


def fed(pipeline, items, orders):
    """Feed bytes, and do each order at its time."""
    waiting = sorted(orders, key=lambda order: order.host_ns)
    for item in items:
        while waiting and waiting[0].host_ns <= item.host_ns:
            order = waiting.pop(0)
            pipeline.act(order.action, order.host_ns)
        pipeline.feed(item)
    return pipeline


@pytest.fixture
def scene():
    return replace(small_scene(), landmarks=(HEAD, TAIL))


def test_a_poke_that_begins_after_the_landmark_is_asked_for_is_at_it_whether_a_taxel_answers_or_not(scene):
    items = bytes_of(scene)
    _, second, _ = starts_of(scene, items)
    pipeline = fed(Pipeline(scene, LINKS, None), items, [Stamped(second - 500_000_000, AskLandmark("head"))])
    kinds = [type(record.outcome) for record in pipeline.snapshot().pokes]
    assert kinds == [Rejection, Contact, Rejection]
    assert pipeline.snapshot().at_landmarks == {2: "head", 3: "head"}
    assert pipeline.snapshot().can_undo == approved("landmark.undo_poke", poke=3, name="head")


def test_a_poke_that_was_on_its_way_is_not_at_it_and_none_is_once_nothing_is_asked_for(scene):
    items = bytes_of(scene)
    _, second, third = starts_of(scene, items)
    late = second - round(REACTION_S * 0.9e9)
    orders = [Stamped(late, AskLandmark("tail")), Stamped(third - 300_000_000, AskLandmark(""))]
    assert fed(Pipeline(scene, LINKS, None), items, orders).snapshot().at_landmarks == {}
    assert fed(Pipeline(scene, LINKS, None), items, orders[:1]).snapshot().at_landmarks == {3: "tail"}


def test_a_landmark_that_is_not_there_cannot_be_asked_for_and_asking_changes_nothing_that_is_known(scene):
    pipeline = Pipeline(scene, LINKS, None)
    before = pipeline.snapshot()
    with pytest.raises(InputError, match="'head', 'tail'"):
        pipeline.act(AskLandmark("nose"), 1)
    pipeline.act(AskLandmark("head"), 2)
    assert pipeline.asked_landmark == "head"
    assert pipeline.snapshot() is before
    with pytest.raises(InputError, match="nothing to undo"):
        pipeline.act(Undo(), 3)
    pipeline.begin_segment()
    assert pipeline.asked_landmark == "", "what follows a break was not asked for"


@pytest.mark.parametrize(
    "action", [AskLandmark("a b"), AskLandmark(""), FoundAtLandmark(3, "a b"), MissedLandmark(3, "a", 0.05, 0.03)]
)
def test_these_actions_travel_as_json(action):
    assert from_json(json.loads(json.dumps(to_json(action)))) == action


@pytest.fixture
def recorded(tmp_path):
    """A session in which a landmark was asked for, undone and asked for again."""
    path = write_scene(tmp_path / "source").path
    with path.open("a", encoding="utf-8") as file:
        for landmark in (HEAD, TAIL):
            file.write(f'\n[[landmarks]]\nname = "{landmark.name}"\nplace = {landmark.place.tolist()}\n')
    scene = load_scene(path)
    items = bytes_of(scene)
    first, _, third = starts_of(scene, items)
    orders = [
        Stamped(first - 500_000_000, AskLandmark("head")),
        Stamped(third - 700_000_000, Undo()),
        Stamped(third - 600_000_000, AskLandmark("tail")),
    ]
    pipeline = fed(Pipeline(scene, LINKS, None, create_session(tmp_path / "s", scene, LINKS)), items, orders)
    pipeline.close()
    return tmp_path / "s", pipeline


@pytest.mark.parametrize("again", [replay, load])
def test_a_session_played_or_loaded_has_the_same_landmark_pokes_and_the_same_to_undo(recorded, again):
    folder, pipeline = recorded
    other = again(folder)
    assert other.findings == ()
    assert pipeline.snapshot().at_landmarks == {1: "head", 3: "tail"}
    assert other.snapshot().at_landmarks == pipeline.snapshot().at_landmarks
    assert other.snapshot().can_undo == pipeline.snapshot().can_undo == approved("landmark.undo_poke", poke=3, name="tail")
    assert same_estimates(other.snapshot(), pipeline.snapshot())


def test_record_makes_the_same_of_the_same_bytes_and_orders(recorded, capsys):
    folder, pipeline = recorded
    items = queue.SimpleQueue()
    for item in SessionLog(folder).items():
        if isinstance(item, Stamped):
            if not isinstance(item.action, FoundAtLandmark | MissedLandmark):
                items.put(OrderLine(item.host_ns, json.dumps(to_json(item.action)).encode()))
        elif hasattr(item, "link"):
            items.put(item)
    items.put(OrderLine(10**18, b'{"do": "ask_landmark", "name": "nose"}\n'))
    items.put(OrderLine(10**18, b"poke 3\n"))
    headless = Pipeline(SessionLog(folder).scene, LINKS, None)
    _loop(headless, items, {}, (None, None), threading.Event())
    assert headless.snapshot().at_landmarks == {1: "head", 3: "tail"}
    mine, theirs = ([outcome_key(poke.outcome) for poke in each.snapshot().pokes] for each in (headless, pipeline))
    assert mine == theirs
    assert same_estimates(headless.snapshot(), pipeline.snapshot())
    said = capsys.readouterr().err
    assert approved("landmark.order_refused", order='{"do": "ask_landmark", "name": "nose"}') in said
    assert approved("landmark.poke_order_refused", channel=3) in said


def test_the_bytes_are_what_counts(recorded):
    """What was found to be at a landmark follows from bytes and orders: without the orders nothing is."""
    folder, _ = recorded
    headless = Pipeline(SessionLog(folder).scene, LINKS, None)
    for item in SessionLog(folder).items():
        if isinstance(item, Chunk):
            headless.feed(item)
    assert headless.snapshot().at_landmarks == {}


FAR = POINT + np.array([0.0, -0.09, 0.0])


def far_and_near(scene, places):
    """A pipeline in which the head was asked for throughout, and what was poked is `places`, in that order."""
    script = Script(scene).quiet()
    for place in places:
        script.press(FORCE, place, {}).quiet()
    items = as_chunks(script.samples)
    orders = [Stamped(starts_of(scene, items)[0] - 500_000_000, AskLandmark("head"))]
    return items, orders


def test_a_poke_that_passes_the_landmark_too_far_is_a_rejection_with_its_number(scene):
    pipeline = fed(Pipeline(scene, LINKS, None), *far_and_near(scene, (POINT, FAR, POINT)))
    snapshot = pipeline.snapshot()
    assert snapshot.at_landmarks == {1: "head", 3: "head"}
    (missed,) = snapshot.decisions.missed_landmarks.values()
    assert (missed.poke, missed.name) == (2, "head")
    across = np.linalg.norm(np.cross(FAR - POINT, FORCE / np.linalg.norm(FORCE)))
    assert missed.miss == pytest.approx(across, abs=1e-6)
    assert 0.01 < missed.limit < missed.miss
    assert snapshot.can_undo == approved("landmark.undo_poke", poke=3, name="head"), "it is no step of its own"


def test_a_push_from_another_side_is_not_at_a_landmark_however_near_its_axis_passes(scene):
    push = FORCE / np.linalg.norm(FORCE)
    front, back = Landmark("front", POINT, -push), Landmark("back", POINT + 0.05 * push, push)
    scene = replace(scene, landmarks=(front, back))
    items = bytes_of(scene, ({}, {}))
    first, second = starts_of(scene, items)
    orders = [Stamped(first - 500_000_000, AskLandmark("front")), Stamped(second - 500_000_000, AskLandmark("back"))]
    snapshot = fed(Pipeline(scene, LINKS, None), items, orders).snapshot()
    assert snapshot.at_landmarks == {1: "front"}
    missed = snapshot.decisions.missed_landmarks[2]
    assert missed.behind
    assert missed.miss < missed.limit
    assert missed_words(missed) == approved("landmark.behind", name="back")


def test_record_says_how_far_it_passed(scene, capsys):
    items, orders = far_and_near(scene, (POINT, FAR, POINT))
    queued = queue.SimpleQueue()
    queued.put(OrderLine(orders[0].host_ns, json.dumps(to_json(orders[0].action)).encode()))
    for item in items:
        queued.put(item)
    pipeline = Pipeline(scene, LINKS, None)
    _loop(pipeline, queued, {}, (None, None), threading.Event())
    (missed,) = pipeline.snapshot().decisions.missed_landmarks.values()
    said = approved("landmark.missed", name="head", seen=f"{missed.miss * 1e3:.0f}", most=f"{missed.limit * 1e3:.0f}")
    assert f"poke 2: {said}\n" in capsys.readouterr().err


def test_the_operator_knows_better(scene):
    pipeline = fed(Pipeline(scene, LINKS, None), *far_and_near(scene, (POINT, FAR)))
    pipeline.act(AtLandmark(2, "head"), 10**18)
    assert pipeline.snapshot().at_landmarks == {1: "head", 2: "head"}
    assert pipeline.snapshot().decisions.missed_landmarks == {}


def test_pokes_that_all_pass_far_show_a_wrong_frame_and_are_kept(scene):
    pipeline = fed(Pipeline(scene, LINKS, None), *far_and_near(scene, (FAR, FAR, FAR)))
    assert pipeline.snapshot().at_landmarks == dict.fromkeys((1, 2, 3), "head")


def test_one_that_was_kept_is_taken_back_once_most_pass_near(scene):
    pipeline = fed(Pipeline(scene, LINKS, None), *far_and_near(scene, (FAR, POINT, POINT)))
    assert pipeline.snapshot().at_landmarks == {2: "head", 3: "head"}
    assert list(pipeline.snapshot().decisions.missed_landmarks) == [1]


@pytest.mark.parametrize("again", [replay, load])
def test_what_missed_is_the_same_in_a_session_that_is_played_or_loaded(tmp_path, again):
    path = write_scene(tmp_path / "source").path
    with path.open("a", encoding="utf-8") as file:
        file.write(f'\n[[landmarks]]\nname = "head"\nplace = {POINT.tolist()}\n')
    scene = load_scene(path)
    items, orders = far_and_near(scene, (FAR, POINT, POINT, FAR))
    pipeline = fed(Pipeline(scene, LINKS, None, create_session(tmp_path / "s", scene, LINKS)), items, orders)
    pipeline.close()
    other = again(tmp_path / "s")
    assert other.findings == ()
    assert list(pipeline.snapshot().decisions.missed_landmarks) == [1, 4]
    assert other.snapshot().decisions.missed_landmarks == pipeline.snapshot().decisions.missed_landmarks
    assert other.snapshot().at_landmarks == pipeline.snapshot().at_landmarks == {2: "head", 3: "head"}

"""Taking back and bringing again: in the session, in its journal, and for the views."""

from __future__ import annotations

import json

import numpy as np
import pytest

from skincal.journal.documents import WallClock
from skincal.journal.writer import create_session
from skincal.model.actions import (
    AtLandmark,
    Exclude,
    FoundAtLandmark,
    MarkDead,
    MissedLandmark,
    Redo,
    Restore,
    Undo,
    from_json,
    to_json,
)
from skincal.model.errors import InputError
from skincal.model.scene import Landmark
from skincal.session.landmark_pokes import SessionLandmarks
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load, replay
from skincal.session.session import Session
from skincal.session.undo import ActionEntry, DeedKind, History, Step, words_of
from tests.skincal.poke_script import LINKS, as_chunks, same_estimates, small_scene, some_pokes, write_scene


@pytest.fixture(scope="module")
def outcomes():
    return some_pokes(small_scene(), 5).run()


@pytest.fixture
def session(outcomes):
    made = Session(small_scene(), None)
    for outcome in outcomes:
        made.add(outcome)
    return made


def test_what_was_taken_back_is_brought_again_newest_first(session):
    first = session.snapshot()
    session.set_clock(WallClock(5.0, 1005.0))
    session.act(Exclude(2), 7.5)
    for _ in range(3):
        session.act(Undo())
    assert session.excluded == (4, 5)
    assert session.snapshot().can_redo == "poke 4"
    assert [words_of(entry) for entry in session.snapshot().undone] == ["exclusion of poke 2", "poke 5", "poke 4"]
    session.act(Redo())
    session.act(Redo())
    assert session.excluded == ()
    assert same_estimates(session.snapshot(), first)
    session.act(Redo())
    assert session.excluded == (2,)
    assert session.history[-1].at_s == 1007.5
    with pytest.raises(InputError, match="nothing to redo"):
        session.act(Redo())


def test_something_else_that_is_done_ends_it_and_a_poke_does_not(session, outcomes):
    other = Session(small_scene(), None)
    for outcome in outcomes:
        if outcome.poke < 5:
            other.add(outcome)
    other.act(Undo())
    other.add(outcomes[-1])
    other.act(Redo())
    assert other.excluded == ()
    assert [words_of(entry) for entry in other.history][-2:] == ["poke 5", "poke 4"]
    session.act(Undo())
    session.act(MarkDead(7))
    assert session.snapshot().can_redo == ""
    with pytest.raises(InputError):
        session.act(Redo())


def test_each_deed_is_told_once_with_its_words(session):
    assert session.snapshot().deed is None
    deeds = []
    for action in (Undo(), Redo(), Exclude(1), Restore(1)):
        session.act(action)
        deeds.append(session.snapshot().deed)
    assert [(deed.number, deed.kind, deed.words) for deed in deeds] == [
        (1, DeedKind.UNDONE, "poke 5"),
        (2, DeedKind.REDONE, "poke 5"),
        (3, DeedKind.DONE, "exclusion of poke 1"),
        (4, DeedKind.DONE, "return of poke 1"),
    ]


def test_redo_travels_as_json():
    assert from_json(json.loads(json.dumps(to_json(Redo())))) == Redo()


@pytest.mark.parametrize("again", [replay, load])
def test_a_session_played_again_has_the_same_history(tmp_path, again):
    scene = write_scene(tmp_path / "source")
    pipeline = Pipeline(scene, LINKS, None, create_session(tmp_path / "s", scene, LINKS))
    items = as_chunks(some_pokes(scene, 5).samples)
    for item in items:
        pipeline.feed(item)
    last = max(item.host_ns for item in items)
    for step, action in enumerate((Exclude(2), Undo(), Undo(), Redo(), Undo())):
        pipeline.act(action, last + step + 1)
    pipeline.close()
    other = again(tmp_path / "s").snapshot()
    mine = pipeline.snapshot()
    assert same_estimates(other, mine)
    assert (other.can_undo, other.can_redo, other.deed) == (mine.can_undo, mine.can_redo, mine.deed)
    assert other.can_redo == "poke 5"
    times = [[entry.at_s for entry in each.undone if isinstance(entry, ActionEntry)] for each in (other, mine)]
    assert times[0] == times[1]


def test_a_poke_that_was_found_far_from_its_landmark_stays_so_when_later_ones_are_taken_back(outcomes):
    by_number = {outcome.poke: outcome for outcome in outcomes}
    landmarks = SessionLandmarks((Landmark("A", np.zeros(3), None),))
    landmarks.put(FoundAtLandmark(1, "A"), by_number[1])
    landmarks.put(FoundAtLandmark(2, "A"), by_number[2])
    landmarks.miss(MissedLandmark(1, "A", 0.06, 0.03, False))
    third = landmarks.put(FoundAtLandmark(3, "A"), by_number[3])
    third.take_back()
    assert dict(landmarks.named(by_number.get)) == {2: "A"}
    by_hand = landmarks.put(AtLandmark(1, "A"), by_number[1])
    assert set(landmarks.named(by_number.get)) == {1, 2}
    by_hand.take_back()
    assert dict(landmarks.named(by_number.get)) == {2: "A"}
    assert set(landmarks.missed) == {1}
    assert landmarks.by_hand == frozenset()


def test_what_was_done_to_a_poke_that_is_gone_is_not_brought_again():
    history = History(lambda _: False, lambda *_: None, lambda action: Step(str(action), lambda: None))
    for number in (1, 2):
        history.do(Exclude(number))
    history.undo()
    history.undo()
    assert [entry.action for entry in history.undone] == [Exclude(2), Exclude(1)]
    history.forget_poke(1)
    assert [entry.action for entry in history.undone] == [Exclude(2)]

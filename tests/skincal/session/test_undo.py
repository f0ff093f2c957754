"""Taking back and bringing again: in the session, in its journal, and for the views."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from skincal.contacts.outcome import Reason, Rejection
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
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load, replay
from skincal.session.session import Session
from skincal.session.undo import ActionEntry, OperationKind, describe_entry
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
    assert [describe_entry(entry) for entry in session.snapshot().history.undone] == ["exclusion of poke 2", "poke 5", "poke 4"]
    session.act(Redo())
    session.act(Redo())
    assert session.excluded == ()
    assert same_estimates(session.snapshot(), first)
    session.act(Redo())
    assert session.excluded == (2,)
    assert session.history.entries[-1].at_s == 1007.5
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
    assert [describe_entry(entry) for entry in other.history.entries][-2:] == ["poke 5", "poke 4"]
    session.act(Undo())
    session.act(MarkDead(7))
    assert session.snapshot().can_redo == ""
    with pytest.raises(InputError):
        session.act(Redo())


def test_each_deed_is_told_once_with_its_words(session):
    assert session.snapshot().history.last is None
    deeds = []
    for action in (Undo(), Redo(), Exclude(1), Restore(1)):
        session.act(action)
        deeds.append(session.snapshot().history.last)
    assert [(deed.number, deed.kind, deed.name) for deed in deeds] == [
        (1, OperationKind.UNDONE, "poke 5"),
        (2, OperationKind.REDONE, "poke 5"),
        (3, OperationKind.DONE, "exclusion of poke 1"),
        (4, OperationKind.DONE, "return of poke 1"),
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
    assert (other.can_undo, other.can_redo, other.history.last) == (mine.can_undo, mine.can_redo, mine.history.last)
    assert other.can_redo == "poke 5"
    times = [[entry.at_s for entry in each.history.undone if isinstance(entry, ActionEntry)] for each in (other, mine)]
    assert times[0] == times[1]


def test_undo_of_a_later_landmark_poke_leaves_what_was_found_since(outcomes):
    session = Session(replace(small_scene(), landmarks=(Landmark("A", np.zeros(3), None),)), None)
    for outcome in outcomes:
        session.add(outcome)

    def known() -> tuple[set[int], set[int]]:
        return set(session.snapshot().at_landmarks), set(session.decisions.missed_landmarks)

    for action in (
        FoundAtLandmark(1, "A"),
        FoundAtLandmark(2, "A"),
        MissedLandmark(1, "A", 0.06, 0.03),
        FoundAtLandmark(3, "A"),
    ):
        session.act(action)
    session.act(Undo())
    assert known() == ({2}, {1})
    session.act(AtLandmark(1, "A"))
    assert known() == ({1, 2}, set())
    assert session.decisions.named_by_hand == {1}
    session.act(Undo())
    assert known() == ({2}, {1})
    assert session.decisions.named_by_hand == frozenset()


def test_undo_of_an_exclusion_leaves_pokes_out_that_were_undone_before_it(session):
    session.act(Exclude(2))
    session.act(Undo())
    session.act(Undo())
    session.act(Exclude(1))
    session.act(Undo())
    assert session.excluded == (5,)
    session.act(Undo())
    assert session.excluded == (4, 5)


def test_what_was_done_to_a_poke_that_is_no_longer_accepted_is_not_redone(session):
    for poke in (1, 2):
        session.act(Exclude(poke))
    session.act(Undo())
    session.act(Undo())
    assert [describe_entry(entry) for entry in session.history.undone] == ["exclusion of poke 2", "exclusion of poke 1"]
    session.add(Rejection(1, 0.0, 0.3, Reason.SLID, 0.0, 1.0, "m", np.empty(0, np.int64), True))
    assert [describe_entry(entry) for entry in session.history.undone] == ["exclusion of poke 2"]

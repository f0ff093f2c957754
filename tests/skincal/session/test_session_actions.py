"""A session under actions: exclusion, undo and redo, dead channels, poses, landmarks, thresholds; each also as JSON."""

import json
import math
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skincal.contacts.outcome import Contact
from skincal.geometry import Arm, DhLink
from skincal.journal.documents import WallClock
from skincal.model import actions as a
from skincal.model.actions import (
    Exclude,
    MarkDead,
    Redo,
    Restore,
    Revive,
    SetThresholds,
    Undo,
    action_from_json,
    action_to_json,
)
from skincal.model.errors import InputError
from skincal.model.scene import ArmSpec, ContactSettings, Landmark
from skincal.session.decisions import ACTION_KINDS, keep_decisions
from skincal.session.session import Session
from skincal.session.undo import OperationKind, describe_entry
from skincal.taxels.result import Method, State
from tests.approved import approved, approved_pattern
from tests.build import rejection, session_of
from tests.skincal.poke_script import outcome_key, same_estimates, small_scene, some_pokes

NUMBERS = st.integers(1, 9)
SOME_CHANNELS = (1, 2, 3, 7, 8, 20)
HEAD = Landmark("A", np.zeros(3), None)


@pytest.fixture(scope="module")
def outcomes():
    return some_pokes(small_scene(), 9).run()


@pytest.fixture
def session(outcomes):
    """Five pokes, a scene with a landmark and a named arm pose."""
    arm = ArmSpec(Arm((0,), (DhLink(0.1, 0.0, 0.0, 0.0),), np.eye(4)), {"up": np.zeros(1), "down": np.ones(1)})
    return session_of(outcomes[:10], replace(small_scene(arm=arm), landmarks=(HEAD,)))


@pytest.mark.parametrize(
    "action",
    [
        *(Exclude(3), Restore(3), Undo(), Redo(), a.SetPose("up"), a.SetPose(""), MarkDead(7), Revive(7)),
        *(SetThresholds(("force_min",), (12.0,)), SetThresholds(), a.AddLandmark("a b", 0.1, -0.2, 1e-3)),
        *(a.AtLandmark(3, "a b"), a.AtLandmark(3, ""), a.AskLandmark("a b"), a.AskLandmark(""), a.FoundAtLandmark(3, "a b")),
        *(a.MissedLandmark(3, "a", 0.05, 0.03), a.BeginClosing(), a.SkipClosing("landmarks", "elbow")),
        *(a.SkipPoke("free", 3, (0.1, 0.2, 0.3), (0.0, 0.0, -1.0)), a.SkipLandmark("", "1", tuple(map(float, range(16))))),
    ],
    ids=str,
)
def test_an_action_comes_back_from_json(action):
    assert action_from_json(json.loads(json.dumps(action_to_json(action)))) == action


@pytest.mark.parametrize(
    "document",
    [
        {},
        {"do": "explode"},
        {"do": "exclude"},
        {"do": "exclude", "poke": "3"},
        {"do": "undo", "poke": 3},
        {"do": "mark_dead", "channel": True},
        {"do": "set_thresholds", "names": ["force_min"], "values": ["4"]},
    ],
    ids=str,
)
def test_what_is_no_action_is_refused(document):
    with pytest.raises(InputError, match="expected"):
        action_from_json(document)


NOT_AT_LANDMARK = approved_pattern("landmark.wrong_contact")
REFUSED = [
    (Exclude(99), approved("session.not_accepted")),
    (Restore(1), "counts already"),
    (a.SetPose("sideways"), approved("session.pose_unknown")),
    (MarkDead(24), "expected 0 to 23"),
    (a.SkipPoke("free", 3, (0.0, 0.0, 0.0), (0.0, 1e308, 1e308)), "expected 3 numbers up to 1e"),
    (a.SkipPoke("free", 3, (0.0, 0.0, math.nan), (0.0, 0.0, -1.0)), "expected 3 numbers up to 1e"),
    (a.SkipClosing("legs", "1"), "no places 'legs'; expected landmarks or taxels"),
    (a.AskLandmark("nose"), "expected one of 'A'"),
    (a.AtLandmark(999, ""), NOT_AT_LANDMARK),
    (a.AtLandmark(999, "A"), NOT_AT_LANDMARK),
    (a.AddLandmark("A", 0.0, 0.0, 0.0), "no other one has"),
    (a.AddLandmark("", 0.0, 0.0, 0.0), "no other one has"),
    (a.AddLandmark("far", 20.0, 0.0, 0.0), "expected metres"),
    (a.AddLandmark("B\0", 0.0, 0.0, 0.0), "The name of the landmark: 'B.*holds a control character; expected plain text"),
    (a.AddLandmark("a\nb", 0.0, 0.0, 0.0), "holds a control character"),
    (a.Uncorrect("rig"), approved_pattern("rig.not_in_use", of="rig")),
    (Redo(), "nothing to redo"),
    (SetThresholds(("force_least",), (4.0,)), "force_least"),
    (SetThresholds(("force_min",), (-4.0,)), "above 0"),
    (SetThresholds(("force_min",), (math.nan,)), "above 0"),
    (SetThresholds(("force_max",), (math.inf,)), "to 1e.06"),
    (SetThresholds(("still_s",), (61.0,)), "to 60"),
    (SetThresholds(("taxels_max",), (2.5,)), "whole number"),
    (SetThresholds(("force_min",), (15.0,)), "rise"),
    (SetThresholds(("touch_force", "touch_force"), (1.0, 1.1)), "each name once"),
    (SetThresholds(("touch_force",), ()), "a value each"),
    (SetThresholds(), "in use already"),
    (SetThresholds(("force_min",), (4.0,)), "in use already"),
]


@pytest.mark.parametrize(("action", "words"), REFUSED, ids=str)
def test_an_action_that_cannot_be_done_changes_nothing(session, action, words):
    before = session.snapshot()
    with pytest.raises(InputError, match=words):
        session.act(action)
    assert session.snapshot() is before
    with pytest.raises(InputError, match="the scene has none: add one first"):
        session_of().act(a.AskLandmark("head"))


def test_estimates_are_those_of_the_final_contacts(outcomes):
    snapshot = session_of(outcomes).snapshot()
    assert same_estimates(snapshot, session_of([outcome for outcome in outcomes if outcome.final]).snapshot())
    assert len(snapshot.contacts) == 9
    assert all(contact.final for contact in snapshot.contacts)
    estimates = {estimate.channel: estimate for estimate in snapshot.estimates[Method.FREE]}
    touched = {int(c) for outcome in outcomes for c in outcome.channels}
    assert {c for c, estimate in estimates.items() if estimate.state is not State.UNSEEN} == touched
    assert (len(estimates), estimates[7].contacts) == (24, 6)
    assert Method.SURFACE not in snapshot.estimates


def test_an_excluded_poke_leaves_no_trace_and_a_restored_one_gives_the_same_bits(outcomes):
    session = session_of(outcomes)
    before = session.snapshot()
    session.act(Exclude(4))
    assert same_estimates(session.snapshot(), session_of([each for each in outcomes if each.poke != 4]).snapshot())
    assert [contact.poke for contact in session.contacts] == [1, 2, 3, 5, 6, 7, 8, 9]
    assert session.snapshot().pokes[3].excluded
    session.act(Restore(4))
    assert same_estimates(session.snapshot(), before)


MOVES = st.lists(
    st.tuples(st.sampled_from(["add", "release", "exclude", "restore", "undo", "reject", "dead", "revive", "look"]), NUMBERS),
    max_size=40,
)


@settings(max_examples=60, deadline=None)
@given(moves=MOVES, layout=st.booleans(), kept=st.sets(NUMBERS))
def test_whatever_was_added_and_taken_away_leaves_no_trace(outcomes, moves, layout, kept):
    """After any sequence of moves a session is made to hold some pokes; it is the one that never held anything else."""
    final = {outcome.poke: outcome for outcome in outcomes if outcome.final}
    session = Session(small_scene(layout=layout), None)
    for move, number in moves:
        play(session, move, number, outcomes)
    for number, outcome in final.items():
        session.add(outcome)
        if (number in kept) == (number in session.excluded):
            session.act(Restore(number) if number in kept else Exclude(number))
    for channel in session.dead:
        session.act(Revive(channel))
    never = session_of([final[number] for number in sorted(kept)], small_scene(layout=layout))
    assert [outcome_key(outcome) for outcome in session.contacts] == [outcome_key(outcome) for outcome in never.contacts]
    assert session.channels == never.channels
    assert same_estimates(session.snapshot(), never.snapshot())


def play(session, move, number, outcomes):
    """Do one move; one that makes no sense as things stand is refused and changes nothing."""
    channel = SOME_CHANNELS[number % len(SOME_CHANNELS)]
    try:
        if move in ("add", "release"):
            session.add(next(outcome for outcome in outcomes if outcome.poke == number and outcome.final == (move == "add")))
        elif move == "reject":
            session.add(rejection(number))
        elif move == "look":
            session.snapshot()
        else:
            moves = {"exclude": Exclude(number), "restore": Restore(number), "undo": Undo()}
            session.act((moves | {"dead": MarkDead(channel), "revive": Revive(channel)})[move])
    except InputError:
        pass


def test_without_a_layout_the_taxels_are_those_that_answered():
    scene = small_scene(layout=False)
    session = session_of(some_pokes(scene, 3).run(), scene)
    assert session.channels == (1, 2, 3, 7, 8)
    session.act(Exclude(3))
    assert session.channels == (1, 2, 3, 7)
    session.act(Undo())
    assert session.channels == (1, 2, 3, 7, 8)


def test_undo_takes_back_everything_the_newest_first(outcomes):
    session = session_of(outcomes[:6])  # pokes 1 to 3
    states, words = [session.snapshot()], []
    for action in (Exclude(1), MarkDead(7), Restore(1)):
        session.act(action)
        states.append(session.snapshot())
    for before in reversed(states[:-1]):
        words.append(session.snapshot().can_undo)
        session.act(Undo())
        assert same_estimates(session.snapshot(), before)
        assert session.snapshot().dead == before.dead
        assert [record.excluded for record in session.snapshot().pokes] == [record.excluded for record in before.pokes]
    assert words == ["return of poke 1", "mark of channel 7", "exclusion of poke 1"]
    for poke in (3, 2, 1):
        assert session.snapshot().can_undo == f"poke {poke}"
        session.act(Undo())
    assert (session.contacts, session.snapshot().can_undo) == ((), "")
    with pytest.raises(InputError, match="nothing to undo"):
        session.act(Undo())


def test_redo_does_again_the_newest_first_with_its_time(session):
    first = session.snapshot()
    session.set_clock(WallClock(5.0, 1005.0))
    session.act(Exclude(2), 7.5)
    for _ in range(3):
        session.act(Undo())
    assert (session.excluded, session.snapshot().can_redo) == ((4, 5), "poke 4")
    assert [describe_entry(entry) for entry in session.history.undone] == ["exclusion of poke 2", "poke 5", "poke 4"]
    session.act(Redo())
    session.act(Redo())
    assert same_estimates(session.snapshot(), first)
    session.act(Redo())
    assert (session.excluded, session.history.entries[-1].at_s) == ((2,), 1007.5)


def test_another_action_ends_redo_and_a_poke_does_not(session, outcomes):
    other = session_of(outcomes[:8])
    other.act(Undo())
    other.add(outcomes[9])
    other.act(Redo())
    assert [describe_entry(entry) for entry in other.history.entries][-2:] == ["poke 5", "poke 4"]
    session.act(Undo())
    session.act(MarkDead(7))
    assert session.snapshot().can_redo == ""


def test_each_operation_is_told_once(session):
    assert session.history.last is None
    told = []
    for action in (Undo(), Redo(), Exclude(1), Restore(1)):
        session.act(action)
        told.append(session.snapshot().history.last)
    assert [(each.number, each.kind, each.name) for each in told] == [
        (1, OperationKind.UNDONE, "poke 5"),
        (2, OperationKind.REDONE, "poke 5"),
        (3, OperationKind.DONE, "exclusion of poke 1"),
        (4, OperationKind.DONE, "return of poke 1"),
    ]


def test_undo_of_a_landmark_poke_leaves_later_findings(session):
    def known() -> tuple[set[int], set[int], set[int]]:
        decisions = session.decisions
        return set(session.snapshot().at_landmarks), set(decisions.missed_landmarks), set(decisions.named_by_hand)

    for action in (
        *(a.FoundAtLandmark(1, "A"), a.FoundAtLandmark(2, "A")),
        *(a.MissedLandmark(1, "A", 0.06, 0.03), a.FoundAtLandmark(3, "A")),
    ):
        session.act(action)
    session.act(Undo())
    assert known() == ({2}, {1}, set())
    session.act(a.AtLandmark(1, "A"))
    assert known() == ({1, 2}, set(), {1})
    session.act(Undo())
    assert known() == ({2}, {1}, set())


def test_undo_of_an_exclusion_leaves_undone_pokes_out(session):
    session.act(Exclude(2))
    session.act(Undo())
    session.act(Undo())
    session.act(Exclude(1))
    session.act(Undo())
    assert session.excluded == (5,)
    session.act(Undo())
    assert session.excluded == (4, 5)


def test_a_poke_that_becomes_a_rejection_leaves_the_history(session):
    for poke in (1, 2):
        session.act(Exclude(poke))
    session.act(Undo())
    session.act(Undo())
    session.add(rejection(1))
    assert [describe_entry(entry) for entry in session.history.undone] == ["exclusion of poke 2"]


def test_a_dead_channel_is_not_estimated_and_a_revived_one_is_as_before(outcomes):
    session = session_of(outcomes)
    before = session.snapshot()
    session.act(MarkDead(7))
    dead = {estimate.channel: estimate for estimate in session.snapshot().estimates[Method.FREE]}[7]
    assert (dead.state, dead.position, session.snapshot().touched.tolist()) == (State.DEAD, None, [7])
    session.act(Revive(7))
    assert same_estimates(session.snapshot(), before)
    session.set_detected_dead({3: "stuck"})
    assert session.snapshot().dead == {3: "stuck"}
    session.act(Revive(3))
    session.set_detected_dead({3: "stuck", 5: "no number"})
    assert session.snapshot().dead == {5: "no number"}, "revived by the operator for good"


def test_a_snapshot_is_the_same_until_something_changes(outcomes):
    session = session_of(outcomes[:2])
    first = session.snapshot()
    assert session.snapshot() is first
    session.add(outcomes[2])
    second = session.snapshot()
    assert (second.generation, second.touched.tolist()) == (first.generation + 1, [int(c) for c in outcomes[2].channels])
    assert len(first.pokes) == 1, "the old picture stays as it was"
    session.act(a.AddLandmark("screw", 0.0, 0.0, 0.0))
    third = session.snapshot()
    assert (third.generation, third.touched.tolist()) == (second.generation + 1, second.touched.tolist())


def test_a_pose_and_thresholds_are_chosen_and_taken_back(session):
    session.act(a.SetPose("up"))
    session.act(a.SetPose("down"))
    session.act(Undo())
    assert session.decisions.pose == "up"
    session.act(SetThresholds(("force_min",), (12.0,)))
    session.act(SetThresholds(("force_max",), (13.0,)))
    assert session.decisions.thresholds == ContactSettings(force_max=13.0)
    session.act(Undo())
    assert session.decisions.thresholds == ContactSettings(force_min=12.0)
    assert session.snapshot().can_redo == "change of thresholds"
    session.act(Redo())
    session.act(SetThresholds())
    assert session.decisions.thresholds == ContactSettings()
    assert session.snapshot().can_undo == "return to the scene's thresholds"


def test_the_calibration_carries_what_was_used_and_what_was_not(outcomes):
    session = session_of(outcomes)
    session.act(Exclude(2))
    session.act(MarkDead(20))
    calibration = session.calibration()
    assert (calibration.excluded, list(calibration.dead)) == ((2,), [20])
    assert [contact.poke for contact in calibration.contacts] == list(range(1, 10))
    assert all(isinstance(each, Contact) for each in calibration.contacts)
    assert len(calibration.estimates[Method.FREE]) == len(calibration.channels) == 24


def test_every_kind_of_action_is_one_row():
    """What can be described can be undone; undo and redo themselves change the history only."""
    assert set(ACTION_KINDS) == set(get_args(a.Action)) - {a.Undo, a.Redo}
    for kind in ACTION_KINDS.values():
        assert (kind.describe is None) == (kind.revert is keep_decisions)

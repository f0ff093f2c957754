"""Actions as JSON, and a session under them: exclusion, undo, dead channels, poses."""

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skincal.contacts.outcome import Contact, Reason, Rejection
from skincal.geometry import Arm, DhLink
from skincal.model.actions import AddLandmark, Exclude, MarkDead, Restore, Revive, SetPose, SkipPoke, Undo, from_json, to_json
from skincal.model.errors import InputError
from skincal.model.scene import ArmSpec
from skincal.session.session import Session
from skincal.taxels.result import Method, State
from tests.approved import approved
from tests.skincal.poke_script import outcome_key, same_estimates, small_scene, some_pokes

NUMBERS = st.integers(1, 9)
SOME_CHANNELS = (1, 2, 3, 7, 8, 20)
ACTIONS = [Exclude(3), Restore(3), Undo(), SetPose("up"), SetPose(""), MarkDead(7), Revive(7)]


@pytest.fixture(scope="module")
def outcomes():
    return some_pokes(small_scene(), 9).run()


def session_of(outcomes, scene=None):
    session = Session(scene or small_scene(), None)
    for outcome in outcomes:
        session.add(outcome)
    return session


@pytest.mark.parametrize("action", ACTIONS, ids=str)
def test_an_action_comes_back_from_json(action):
    assert from_json(json.loads(json.dumps(to_json(action)))) == action


@pytest.mark.parametrize(
    "document",
    [
        {},
        {"do": "explode"},
        {"do": "exclude"},
        {"do": "exclude", "poke": "3"},
        {"do": "undo", "poke": 3},
        {"do": "mark_dead", "channel": True},
    ],
    ids=str,
)
def test_what_is_no_action_is_refused(document):
    with pytest.raises(InputError, match="expected"):
        from_json(document)


def test_the_second_outcome_of_a_poke_replaces_the_first(outcomes):
    session = session_of(outcomes)
    assert len(session.contacts) == 9
    assert all(contact.final for contact in session.contacts)
    assert same_estimates(session.snapshot(), session_of([outcome for outcome in outcomes if outcome.final]).snapshot())


def test_estimates_are_those_of_the_contacts(outcomes):
    snapshot = session_of(outcomes).snapshot()
    estimates = {estimate.channel: estimate for estimate in snapshot.estimates[Method.FREE]}
    assert len(estimates) == 24
    touched = {int(c) for outcome in outcomes for c in outcome.channels}
    assert {c for c, estimate in estimates.items() if estimate.state is not State.UNSEEN} == touched
    assert estimates[7].contacts == 6
    assert Method.SURFACE not in snapshot.estimates


def test_an_excluded_poke_leaves_no_trace(outcomes):
    session = session_of(outcomes)
    session.snapshot()
    session.act(Exclude(4))
    never = session_of([outcome for outcome in outcomes if outcome.poke != 4])
    assert same_estimates(session.snapshot(), never.snapshot())
    assert [contact.poke for contact in session.contacts] == [1, 2, 3, 5, 6, 7, 8, 9]
    assert session.snapshot().pokes[3].excluded


def test_a_restored_poke_gives_the_same_bits_as_before(outcomes):
    session = session_of(outcomes)
    before = session.snapshot()
    session.act(Exclude(4))
    assert not same_estimates(session.snapshot(), before)
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
    never = Session(small_scene(layout=layout), None)
    for number in sorted(kept):
        never.add(final[number])
    assert [outcome_key(outcome) for outcome in session.contacts] == [outcome_key(outcome) for outcome in never.contacts]
    assert session.channels == never.channels
    assert same_estimates(session.snapshot(), never.snapshot())


def play(session, move, number, outcomes):
    """Do one move; one that makes no sense as things stand is refused and changes nothing."""
    empty = np.empty(0, dtype=np.int64)
    channel = SOME_CHANNELS[number % len(SOME_CHANNELS)]
    try:
        if move in ("add", "release"):
            session.add(next(outcome for outcome in outcomes if outcome.poke == number and outcome.final == (move == "add")))
        elif move == "reject":
            session.add(Rejection(number, 0.0, 1.0, Reason.SLID, 1.0, 0.5, "", empty, final=True))
        elif move == "look":
            session.snapshot()
        else:
            actions = {"exclude": Exclude(number), "restore": Restore(number), "undo": Undo()}
            session.act((actions | {"dead": MarkDead(channel), "revive": Revive(channel)})[move])
    except InputError:
        pass


def test_without_a_layout_the_taxels_are_those_that_answered():
    scene = small_scene(layout=False)
    outcomes = some_pokes(scene, 3).run()
    session = session_of(outcomes, scene)
    assert session.channels == (1, 2, 3, 7, 8)
    session.act(Exclude(3))
    assert session.channels == (1, 2, 3, 7)
    assert same_estimates(
        session.snapshot(), session_of([outcome for outcome in outcomes if outcome.poke != 3], scene).snapshot()
    )
    session.act(Undo())
    assert session.channels == (1, 2, 3, 7, 8)


def test_undo_takes_back_everything_the_newest_first(outcomes):
    session = session_of(outcomes[:6])  # pokes 1 to 3
    states = [session.snapshot()]
    for action in (Exclude(1), MarkDead(7), Restore(1)):
        session.act(action)
        states.append(session.snapshot())
    words = []
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
    assert session.contacts == ()
    assert session.snapshot().can_undo == ""
    with pytest.raises(InputError, match="nothing to undo"):
        session.act(Undo())


def test_undo_after_an_exclusion_of_the_last_poke_restores_it(outcomes):
    session = session_of(outcomes[:6])
    session.act(Exclude(3))
    assert session.snapshot().can_undo == "exclusion of poke 3"
    session.act(Undo())
    assert [contact.poke for contact in session.contacts] == [1, 2, 3]


@pytest.mark.parametrize(
    ("action", "words"),
    [
        (Exclude(99), approved("session.not_accepted")),
        (Restore(1), "counts already"),
        (SetPose("sideways"), approved("session.pose_unknown")),
        (MarkDead(24), "expected 0 to 23"),
        (SkipPoke("free", 3, (0.0, 0.0, 0.0), (0.0, 1e308, 1e308)), "expected 3 numbers up to 1e"),
        (SkipPoke("free", 3, (0.0, 0.0, math.nan), (0.0, 0.0, -1.0)), "expected 3 numbers up to 1e"),
    ],
    ids=str,
)
def test_an_action_that_cannot_be_done_changes_nothing(outcomes, action, words):
    session = session_of(outcomes)
    before = session.snapshot()
    with pytest.raises(InputError, match=words):
        session.act(action)
    assert session.snapshot() is before


def test_a_dead_channel_is_not_estimated_and_a_revived_one_is_as_before(outcomes):
    session = session_of(outcomes)
    before = session.snapshot()
    session.act(MarkDead(7))
    dead = {estimate.channel: estimate for estimate in session.snapshot().estimates[Method.FREE]}[7]
    assert (dead.state, dead.position) == (State.DEAD, None)
    assert session.snapshot().touched.tolist() == [7]
    session.act(Revive(7))
    assert same_estimates(session.snapshot(), before)


def test_what_the_operator_revives_is_not_found_dead_again(outcomes):
    session = session_of(outcomes)
    session.set_detected_dead({3: "stuck"})
    assert session.snapshot().dead == {3: "stuck"}
    session.act(Revive(3))
    session.set_detected_dead({3: "stuck", 5: "no number"})
    assert session.snapshot().dead == {5: "no number"}


def test_a_snapshot_is_the_same_until_something_changes(outcomes):
    session = session_of(outcomes[:2])
    first = session.snapshot()
    assert session.snapshot() is first
    session.add(outcomes[2])
    second = session.snapshot()
    assert second.generation > first.generation
    assert second.touched.tolist() == [int(c) for c in outcomes[2].channels]
    assert len(first.pokes) == 1  # the old picture stays as it was
    session.act(AddLandmark("screw", 0.0, 0.0, 0.0))
    third = session.snapshot()
    assert third.generation > second.generation
    assert third.touched.tolist() == second.touched.tolist()  # a landmark is no poke


def test_a_pose_is_chosen_and_taken_back():
    arm = ArmSpec(Arm((0,), (DhLink(0.1, 0.0, 0.0, 0.0),), np.eye(4)), {"up": np.zeros(1), "down": np.ones(1)})
    session = Session(small_scene(arm=arm), None)
    session.act(SetPose("up"))
    session.act(SetPose("down"))
    session.act(Undo())
    assert session.decisions.pose == "up"


def test_the_calibration_carries_what_was_used_and_what_was_not(outcomes):
    session = session_of(outcomes)
    session.act(Exclude(2))
    session.act(MarkDead(20))
    calibration = session.calibration()
    assert calibration.excluded == (2,)
    assert [contact.poke for contact in calibration.contacts] == list(range(1, 10))
    assert list(calibration.dead) == [20]
    assert all(isinstance(each, Contact) for each in calibration.contacts)
    assert len(calibration.estimates[Method.FREE]) == len(calibration.channels) == 24

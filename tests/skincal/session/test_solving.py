"""A session that is solved in parts: paused, gone on with, and the same at the end as solved at once."""

import gc
import itertools
import weakref
from dataclasses import replace

import numpy as np
import pytest

from skincal.model.actions import Exclude, MarkDead, Undo
from skincal.model.errors import InputError
from skincal.rig.correction import RIG, Correction, UsedCorrection
from skincal.session import solving
from skincal.session.corrections import correct_action
from skincal.session.solving import MODULES_AT_ONCE, TAXELS_AT_ONCE
from skincal.simulation.contacts import simulate_contacts, unguided
from skincal.simulation.rig_errors import RigErrors
from skincal.taxels.contact_table import ContactTable
from skincal.taxels.result import Method
from tests import build
from tests.skincal.poke_script import same_estimates
from tests.skincal.sim_support import make_rig

MATRIX = np.eye(6) + 1e-3 * np.arange(36).reshape(6, 6) / 36
ACTION = correct_action(UsedCorrection(RIG, Correction(MATRIX, np.eye(4)), 0.009, 0.002, 6))


@pytest.fixture(scope="module")
def rig():
    return make_rig(RigErrors.noise(), 1)


@pytest.fixture(scope="module")
def contacts(rig):
    rng = np.random.default_rng(3)
    return simulate_contacts(rig, unguided(rig, 1, rng), rng)


def session_of(rig, contacts, *, layout=True):
    scene = rig.scene if layout else replace(rig.scene, skin=replace(rig.scene.skin, layout=None, anchor=None))
    made = build.session_of(contacts, scene, rig.surface)
    made.snapshot()
    return made


def steps_to_the_end(session):
    """Solve in the smallest steps; return how many are waiting after each."""
    waiting, before = [], None
    while True:
        snapshot = session.snapshot(0.0)
        waiting.append(session.unsolved)
        if not session.unsolved:
            assert session.snapshot() is snapshot
            return waiting
        assert before is None or snapshot is before, "until all is solved, what was known before is shown"
        before = snapshot


@pytest.mark.parametrize("layout", [True, False], ids=["modules", "no layout"])
def test_a_correction_solved_in_parts_is_the_same_to_the_bit(rig, contacts, layout):
    at_once, in_parts = (session_of(rig, contacts, layout=layout) for _ in range(2))
    for session in (at_once, in_parts):
        session.act(ACTION)
    shown = in_parts.snapshot(0.0)
    assert not shown.decisions.corrections
    waiting = [in_parts.unsolved, *steps_to_the_end(in_parts)]
    assert waiting == sorted(waiting, reverse=True)
    assert all(a - b <= max(TAXELS_AT_ONCE, 12 * MODULES_AT_ONCE) for a, b in itertools.pairwise(waiting))
    assert same_estimates(at_once.snapshot(), in_parts.snapshot())
    assert in_parts.snapshot().decisions.corrections.keys() == {RIG}
    assert in_parts.snapshot().generation == shown.generation + 1
    assert set(in_parts.snapshot().touched) == set(at_once.snapshot().touched) >= set(in_parts.channels)


def test_what_comes_in_between_is_in_it_too(rig, contacts):
    at_once, in_parts = session_of(rig, contacts[:-1]), session_of(rig, contacts[:-1])
    for session, pauses in ((at_once, False), (in_parts, True)):
        session.act(ACTION)
        if pauses:
            session.snapshot(0.0)
        session.add(contacts[-1])
        session.act(Exclude(contacts[0].poke))
        if pauses:
            session.snapshot(0.0)
        session.act(MarkDead(int(contacts[5].channels[0])))
    assert in_parts.unsolved
    steps_to_the_end(in_parts)
    assert same_estimates(at_once.snapshot(), in_parts.snapshot())
    assert len(in_parts.snapshot().pokes) == len(contacts)
    assert in_parts.snapshot().dead


def test_a_file_is_written_from_what_is_solved_to_the_end(rig, contacts):
    at_once, in_parts = session_of(rig, contacts), session_of(rig, contacts)
    for session in (at_once, in_parts):
        session.act(ACTION)
    in_parts.snapshot(0.0)
    assert in_parts.unsolved
    written = in_parts.calibration().estimates[Method.MODULES]
    assert not in_parts.unsolved
    assert [estimate.position.tolist() for estimate in written] == [
        estimate.position.tolist() for estimate in at_once.snapshot().estimates[Method.MODULES]
    ]


def test_what_is_asked_meanwhile_is_of_the_snapshot_that_is_shown(rig, contacts, monkeypatch):
    monkeypatch.setattr(solving, "MODULES_AT_ONCE", 1)
    session = session_of(rig, contacts[:-1])
    channels = [int(channel) for channel in contacts[-1].channels]
    shown = session.snapshot()
    before = shown.evidence(channels)
    session.act(ACTION)
    session.snapshot(0.0)
    session.add(contacts[-1])
    session.snapshot(0.0)
    assert session.unsolved
    assert session.snapshot(0.0) is shown
    meanwhile = shown.evidence(channels)
    assert contacts[-1].poke not in meanwhile.pokes.tolist()
    assert np.array_equal(meanwhile.columns, before.columns), "as the rig reported it: the estimates that are shown are of that"
    steps_to_the_end(session)
    after = session.snapshot().evidence(channels)
    assert contacts[-1].poke in after.pokes.tolist()
    assert after.columns.shape != before.columns.shape
    assert np.array_equal(shown.evidence(channels).columns, before.columns), "a snapshot keeps its contacts"


def test_the_same_correction_is_not_used_twice(rig, contacts):
    session = session_of(rig, contacts[:20])
    before = session.snapshot()
    session.act(ACTION)
    with pytest.raises(InputError, match="in use already"):
        session.act(ACTION)
    session.snapshot(0.0)
    session.act(Undo())
    steps_to_the_end(session)
    assert same_estimates(before, session.snapshot()), "taken back before it was solved"
    session.act(ACTION)
    assert session.snapshot().decisions.corrections
    session.add(contacts[20])
    session.snapshot(0.0)
    assert not session.unsolved, "a poke is solved in one step"


def test_a_snapshot_answers_alike_for_good_and_in_any_thread(rig, contacts):
    session = session_of(rig, contacts[:-1])
    shown, channels = session.snapshot(), session.channels
    shared, own = shown.evidence(channels), shown.detached().evidence(channels)
    session.add(contacts[-1])
    assert session.snapshot().evidence(channels).columns.shape != shared.columns.shape
    for found in (own, shown.evidence(channels)):
        for name in ("channels", "starts", "pokes", "columns", "weights", "trust", "unranked"):
            assert np.array_equal(getattr(found, name), getattr(shared, name)), name


def test_snapshots_keep_no_table_alive(rig, contacts, monkeypatch):
    """A view, a dialog or a course of errors may hold snapshots as long as it likes."""
    monkeypatch.setattr(solving, "MODULES_AT_ONCE", 1)
    gc.collect()
    tables_before = len([each for each in gc.get_objects() if type(each) is ContactTable])
    session, held = session_of(rig, contacts[:20]), []
    table = weakref.ref(session._solving._shown)
    for action in (ACTION, Undo(), ACTION, Undo()):
        held.append(session.snapshot())
        session.act(action)
        steps_to_the_end(session)
    gc.collect()
    assert len(held) == 4
    assert table() is None, "solved in parts, each correction has a table of its own"
    assert len([each for each in gc.get_objects() if type(each) is ContactTable]) <= 1 + tables_before

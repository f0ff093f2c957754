"""Turns of a session that grows: the same to the last bit by every way to the same contacts."""

from dataclasses import replace

import numpy as np
import pytest

import skincal
from skincal.axes.session_turns import TurnSolving
from skincal.axes.skin_turns import fit_group, pokes_by_taxel
from skincal.model.actions import Exclude, Undo
from tests.skincal.axes.axis_support import turn_between
from tests.skincal.interface.test_turns import make_scene, poke_arrays


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """A solved session of 54 pokes on nine taxels that share their axes, and these."""
    wrenches, frames, axes = poke_arrays()
    return skincal.solve(make_scene(tmp_path_factory.mktemp("turns")), wrenches, frames).results.session, axes


def fed(session, contacts):
    solving = TurnSolving(session.scene.skin.layout, session.scene.noise.force)
    for contact in contacts:
        solving.poke_changed(contact.poke, contact)
    solving.solve()
    return solving.turns({}, {})


def numbers(turns):
    """All rotations, covariances and odds, as bytes."""
    taxels = [(c, t.fit.rotation.tobytes(), t.fit.covariance.tobytes()) for c, t in turns.skin.taxels.items()]
    modules = [(m.id, m.turn.fit.rotation.tobytes(), m.log_odds_shared) for m in turns.modules.values()]
    return taxels, modules, turns.skin.noise


def test_a_growing_session_has_the_turns_of_all_its_contacts(session):
    """One by one, some too late, one excluded and restored, and with a time limit of nothing."""
    session, _ = session
    contacts = session.contacts[:30]
    once = fed(session, contacts)
    solving = TurnSolving(session.scene.skin.layout, session.scene.noise.force)
    for contact in (*contacts[:7], *contacts[8:], contacts[7]):
        solving.poke_changed(contact.poke, contact)
        if contact.poke % 9 == 0:
            solving.solve(0.0)
    solving.poke_changed(contacts[3].poke, None)
    solving.solve()
    assert numbers(solving.turns({}, {})) != numbers(once)
    assert numbers(solving.turns({}, {})) == numbers(fed(session, [each for each in contacts if each is not contacts[3]]))
    solving.poke_changed(contacts[3].poke, contacts[3])
    steps = 0
    while solving.waiting or not steps:
        solving.solve(0.0)
        steps += 1
    assert steps > 5
    assert numbers(solving.turns({}, {})) == numbers(once)


def test_the_tare_after_an_early_poke_changes_the_noise_that_all_share(session):
    session, _ = session
    contacts = session.contacts[:20]
    later = replace(contacts[2], force=contacts[2].force + np.array([0.3, -0.2, 0.1]))
    solving = TurnSolving(session.scene.skin.layout, session.scene.noise.force)
    solving.pokes_changed([contact.poke for contact in contacts], contacts)
    solving.solve()
    solving.pokes_changed([later.poke], [later])
    solving.solve()
    assert numbers(solving.turns({}, {})) == numbers(fed(session, [*contacts[:2], later, *contacts[3:]]))


def test_a_poke_changes_the_taxels_that_it_presses_alone(session):
    session, _ = session
    solving = TurnSolving(None, session.scene.noise.force)
    for contact in session.contacts[:20]:
        solving.poke_changed(contact.poke, contact)
    solving.solve()
    before = solving.turns({}, {})
    solving.poke_changed(session.contacts[20].poke, session.contacts[20])
    assert solving.waiting == 1
    solving.solve()
    after = solving.turns({}, {})
    changed = [channel for channel, turn in after.skin.taxels.items() if turn is not before.skin.taxels.get(channel)]
    assert changed == session.contacts[20].channels.tolist()
    own = pokes_by_taxel(session.contacts[:21])[changed[0]]
    direct = fit_group((changed[0],), own, after.skin.noise)
    assert np.array_equal(direct.fit.rotation, after.skin.taxels[changed[0]].fit.rotation)


def test_a_taxel_without_pokes_has_the_turn_that_its_module_shares(session):
    session, axes = session
    contacts = [contact for contact in session.contacts if contact.strongest_channel != 4]
    turns = fed(session, contacts)
    assert 4 not in turns.skin.taxels
    shown = turns.of_channel(4)
    assert shown is not None
    assert shown.module is turns.modules[3]
    assert np.degrees(np.linalg.norm(turn_between(shown.fit.rotation, axes))) < 1.0
    one = fed(session, contacts[:1])
    assert one.of_channel(4) is None
    assert one.of_channel(0).module is None


def test_a_contact_that_counts_no_more_leaves_nothing(session):
    session, _ = session
    solving = TurnSolving(session.scene.skin.layout, session.scene.noise.force)
    first = session.contacts[0]
    solving.poke_changed(first.poke, first)
    solving.solve()
    solving.poke_changed(first.poke, None)
    solving.solve()
    assert not solving.turns({}, {}).skin.taxels
    assert not solving.turns({}, {}).modules
    assert solving.turns({}, {}).of_channel(0) is None


def test_a_snapshot_has_turns_that_follow_its_decisions(tmp_path):
    wrenches, frames, _ = poke_arrays()
    session = skincal.solve(make_scene(tmp_path), wrenches[:12], frames[:12]).results.session
    before = session.snapshot().turns
    session.act(Exclude(11))
    after = session.snapshot(0.0).turns
    while session.unsolved:
        after = session.snapshot(0.0).turns
    assert [len(turns.skin.pokes[1]) for turns in (before, after)] == [2, 1]
    session.act(Undo())
    assert numbers(session.snapshot().turns) == numbers(before)

"""Taxels whose own pokes contradict the place that their module gives them, and channels that look exchanged."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from skincal.files.layout_sources import parse_grid
from skincal.methods import estimate_taxels
from skincal.model.actions import Exclude
from skincal.model.skin import read_layout
from skincal.modules.pose import ModuleModel
from skincal.session.session import Session
from skincal.simulation.contacts import simulate_contacts, unguided
from skincal.simulation.example_parts import forearm
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.simulated_rig import Rig
from skincal.taxels.exchanged import find_denied, find_exchanged
from skincal.taxels.result import Cause, Method, State

ACROSS_MODULES = 300, 340
"""Channels in two modules of the forearm."""


@cache
def pressed(kind, errors="noise", rounds=2, seed=2):
    """Scene and contacts of unguided presses on a grid of 5 x 7 taxels, or on the shipped forearm."""
    scene = forearm().scene
    if kind != "forearm":
        size = parse_grid("5x7@9mm")
        layout = read_layout(size.layout_text().replace('kind = "sheet"', f'kind = "{kind}"'), Path("grid.modules.toml"), 35)
        scene = replace(scene, skin=replace(scene.skin, channels=35, layout=layout), landmarks=())
    rig = Rig(scene, forearm().surface, getattr(RigErrors, errors)(), np.random.default_rng([seed, 7]))
    rng = np.random.default_rng([seed, 11])
    return scene, simulate_contacts(rig, unguided(rig, rounds, rng), rng, next(iter(rig.arm_poses)))


def renamed(contacts, names, silent=()):
    """Contacts with other names of channels, without the `silent` ones."""
    found = []
    for contact in contacts:
        channels = np.array([names.get(channel, channel) for channel in contact.channels.tolist()])
        order = [at for at in np.argsort(channels) if channels[at] not in silent]
        if order:
            found.append(replace(contact, channels=channels[order], responses=contact.responses[order]))
    return found


def judged(scene, contacts):
    """Estimates of the modules method by channel, the pairs that look exchanged, and the channels to name."""
    layout = scene.skin.layout
    channels, model = layout.channels.tolist(), ModuleModel(layout, scene.skin.anchor, forearm().surface)
    methods = [Method.SURFACE, Method.MODULES]
    solved = estimate_taxels(contacts, channels, methods, scene.noise, forearm().surface, model=model)
    alone, placed = (list(solved[method].values()) for method in methods)
    pairs = find_exchanged(placed, alone)
    return solved[Method.MODULES], pairs, find_denied(placed, pairs)


def exchange(*pairs):
    return dict(pairs) | {other: one for one, other in pairs}


@pytest.mark.parametrize("rounds", [1, 2])
@pytest.mark.parametrize("kind", ["sheet", "board"])
def test_exchanged_pairs_are_named_and_have_no_position(kind, rounds):
    scene, contacts = pressed(kind, rounds=rounds)
    placed, pairs, denied = judged(scene, renamed(contacts, exchange((8, 26), (10, 30))))
    assert pairs == ((8, 26), (10, 30))
    assert denied == (8, 10, 26, 30)
    for channel in denied:
        found = placed[channel]
        assert (found.state, found.reason.cause) == (State.BLIND, Cause.CONTRADICTED)
        assert (found.position, found.covariance, found.sd, found.rms) == (None, None, None, None)
        assert found.reason.size > 0.02


@pytest.mark.parametrize("kind", ["sheet", "board"])
def test_a_channel_that_never_answers_is_named_with_the_one_that_answers_at_its_place(kind):
    scene, contacts = pressed(kind)
    placed, pairs, _ = judged(scene, renamed(contacts, exchange((8, 26)), silent=(26,)))
    assert pairs == ((8, 26),)
    assert (placed[26].reason.cause, placed[26].reason.count) == (Cause.CLAIMED, 8)
    assert placed[26].position is None


@pytest.mark.parametrize("kind", ["sheet", "board"])
def test_three_channels_in_a_circle_contradict_their_places(kind):
    scene, contacts = pressed(kind)
    placed, pairs, _ = judged(scene, renamed(contacts, {8: 26, 26: 11, 11: 8}))
    assert ({each.channel for each in placed.values() if each.is_contradicted}, pairs) == ({8, 11, 26}, ())


def test_channels_of_two_modules_that_are_exchanged_are_named():
    scene, contacts = pressed("forearm")
    _, pairs, _ = judged(scene, renamed(contacts, exchange(ACROSS_MODULES)))
    assert pairs == (ACROSS_MODULES,)


@pytest.mark.parametrize("kind", ["sheet", "board", "forearm"])
@pytest.mark.parametrize("errors", ["noise", "paper"])
def test_a_right_layout_has_no_contradiction(kind, errors):
    placed, pairs, denied = judged(*pressed(kind, errors))
    assert (pairs, denied) == ((), ())
    assert not any(each.is_contradicted for each in placed.values())


def test_an_answer_that_agrees_outweighs_a_poke_far_off():
    """The only own poke of a taxel lies in another module, and pokes of its neighbours, which it answers weakly, agree."""
    scene, contacts = pressed("forearm")
    own = [each for each in contacts if each.strongest_channel == ACROSS_MODULES[0]]
    weak = [each for each in contacts if ACROSS_MODULES[0] in each.channels and each not in own]
    assert weak
    wrong = replace(next(each for each in contacts if each.strongest_channel == ACROSS_MODULES[1]), poke=9999)
    rest = [each for each in contacts if each not in own]
    placed, _, denied = judged(scene, [*rest, *renamed([wrong], exchange(ACROSS_MODULES))])
    assert (placed[ACROSS_MODULES[0]].is_contradicted, denied) == (False, ())
    far = [each for each in rest if each not in weak]
    assert judged(scene, [*far, *renamed([wrong], exchange(ACROSS_MODULES))])[0][ACROSS_MODULES[0]].is_contradicted


def test_one_poke_far_off_asks_for_another_and_names_nobody():
    scene, contacts = pressed("sheet")
    own = [each for each in contacts if each.strongest_channel == 8]
    rest = [each for each in contacts if 8 not in each.channels]
    wrong = [replace(each, poke=9999) for each in rest if each.strongest_channel == 26][:1]
    placed, pairs, denied = judged(scene, [*rest, *renamed(wrong, {26: 8})])
    assert placed[8].is_contradicted
    assert (pairs, denied) == ((), ())
    assert judged(scene, [*rest, *own, *renamed(wrong, {26: 8})])[0][8].state is State.TOUCHED


def test_a_session_gives_a_place_back_when_the_pokes_on_it_are_excluded():
    scene, contacts = pressed("sheet")
    contacts = renamed(contacts, exchange((8, 26)), silent=(26,))
    session = Session(scene, forearm().surface)
    for contact in contacts:
        session.add(contact)
    whole = judged(scene, contacts)[0]

    def of(channel):
        return {each.channel: each for each in session.snapshot().estimates[Method.MODULES]}[channel]

    assert (of(8).reason, of(26).reason) == (whole[8].reason, whole[26].reason)
    for contact in contacts:
        if contact.strongest_channel == 8:
            session.act(Exclude(contact.poke))
    assert (of(26).state, of(26).reason.cause) == (State.INFERRED, Cause.BY_MODULE)

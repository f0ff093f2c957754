"""Channels that cables or programs bring in another order: named, and the corrected layout gives right positions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skincal.following.results import SessionResults
from skincal.part.part import load_part
from skincal.rig import setup_check
from skincal.rig.channel_order import channel_orders, exchanged_order
from skincal.rig.setup_check import check_setup
from skincal.session.replay import load
from skincal.taxels.result import Method
from skincal.words.mistake_words import setup_sentences
from tests.skincal.soldered_board import Board, errors, import_board, layout_text, poke, write_rig

BOARD = Board(rows=6, columns=8, pokes_each=1, pitch=0.012)
ALL = np.arange(48)
GRID = ALL.reshape(6, 8)
ORDERS = {
    "halves": (np.roll(ALL, 24), "channels 0 to 23 and 24 to 47 are exchanged", "exchange these lines of its pads_mm"),
    "blocks": (np.r_[ALL[:16], ALL[32:], ALL[16:32]], "channels 16 to 31 and 32 to 47 are exchanged", "connectors"),
    "half columns": (np.c_[GRID[:, 4:], GRID[:, :4]].ravel(), "the halves of the layout's columns are exchanged", "connectors"),
    "backwards": (
        np.array([row[:: 1 - 2 * (k % 2)] for k, row in enumerate(GRID)]).ravel(),
        "every second row",
        "turn the order",
    ),
}


@pytest.fixture(scope="module")
def frames():
    return poke(BOARD)


@pytest.fixture(scope="module")
def right(frames, tmp_path_factory):
    """The contacts of a board whose order is right, and its snapshot; its sentences are none."""
    folder = tmp_path_factory.mktemp("right")
    snapshot = import_board(folder, frames, frames.plain, layout=True)
    return snapshot, sentences(folder)


def sentences(folder):
    return setup_sentences(SessionResults(load(folder / "s")).setup)


def brought_by(order, contacts):
    """The contacts as a table has them whose column k is that of taxel `order[k]`."""
    columns, made = np.argsort(order), []
    for contact in contacts:
        channels = columns[contact.channels]
        rows = np.argsort(channels)
        made.append(replace(contact, channels=channels[rows], responses=contact.responses[rows]))
    return made


def said_of(contacts, frames, folder, **layout):
    """What is said of contacts under a layout."""
    one = replace(frames, times=frames.times[:1], wrench=frames.wrench[:1])
    scene, _ = write_rig(folder, one, frames.plain[:1], layout=True, **layout)
    part = load_part(scene)
    return setup_sentences(check_setup(contacts, part.scene, part.laid, part.surface))


@pytest.mark.parametrize(("order", "what", "remedy"), ORDERS.values(), ids=ORDERS)
def test_an_exchange_is_named_and_nothing_is_said_of_its_remedy(right, frames, tmp_path, order, what, remedy):
    """Line k of the layout is that of taxel k until it is corrected."""
    contacts = brought_by(order, right[0].contacts)
    said = said_of(contacts, frames, tmp_path / "a")
    assert len(said) == 1
    assert what in said[0]
    assert remedy in said[0]
    assert said_of(contacts, frames, tmp_path / "b", file=layout_text(BOARD, order)) == ()


def test_an_exchange_in_a_table_is_named_and_its_remedy_gives_right_positions(frames, tmp_path):
    order, what, remedy = ORDERS["half columns"]
    import_board(tmp_path / "a", frames, frames.plain[:, order], layout=True)
    said = sentences(tmp_path / "a")
    assert len(said) == 1
    assert what in said[0]
    assert remedy in said[0]
    import_board(tmp_path / "b", frames, frames.plain[:, order], layout=True, file=layout_text(BOARD, order))
    assert sentences(tmp_path / "b") == ()
    for each in load(tmp_path / "b" / "s").snapshot().estimates[Method.MODULES]:
        assert np.linalg.norm(each.position - BOARD.places[order[each.channel]]) < 0.0005


def test_exchanged_halves_of_two_modules_are_their_first_channels(right, frames, tmp_path):
    contacts = brought_by(np.roll(ALL, 24), right[0].contacts)
    assert any("first_channel" in each for each in said_of(contacts, frames, tmp_path, file=layout_text(BOARD, blocks=2)))


def test_no_change_is_advised_that_leaves_taxels_far_from_their_places(right, frames, tmp_path):
    """No hypothesis explains an arbitrary order: nothing is advised."""
    order = np.random.default_rng(7).permutation(48)
    assert said_of(brought_by(order, right[0].contacts), frames, tmp_path) == ()


def test_a_right_order_is_not_doubted(right):
    snapshot, said = right
    assert said == ()
    assert errors(snapshot, BOARD)[:, 0].mean() < 0.0008


def test_an_exchange_places_again_only_the_pokes_on_exchanged_channels(right, frames, tmp_path, monkeypatch):
    contacts, plan = right[0].contacts, setup_check._planned
    one = replace(frames, times=frames.times[:1], wrench=frames.wrench[:1])
    part = load_part(write_rig(tmp_path, one, frames.plain[:1], layout=True)[0])
    exchange = setup_check._ChannelExchange(setup_check._as_described(contacts, part.laid), contacts, part.laid)
    placed = []
    monkeypatch.setattr(setup_check, "_planned", lambda used, laid, order: placed.append(used) or plan(used, laid, order))
    layout = part.scene.skin.layout
    two_taxels = exchanged_order(layout, np.array([0, 1]), np.array([46, 47]))
    for order in (ALL, two_taxels, *(order for _, _, order in channel_orders(layout))):
        placed.clear()
        found, (places, normals) = exchange.in_order(order), plan(contacts, part.laid, order)
        assert found.places.tobytes() == places.tobytes()
        assert found.normals.tobytes() == normals.tobytes()
        of_exchanged = [each for each in contacts if (order != ALL)[each.channels].any()]
        assert [each.poke for used in placed for each in used] == [each.poke for each in of_exchanged]
    placed.clear()
    exchange.in_order(two_taxels)
    assert 0 < len(placed[0]) < len(contacts) / 2

"""Channels that cables or programs bring in another order: named, and the corrected layout gives right positions."""

from __future__ import annotations

import numpy as np
import pytest

from skincal.following.results import SessionResults
from skincal.session.replay import load
from skincal.taxels.result import Method
from skincal.words.setup_words import setup_sentences
from tests.skincal.soldered_board import Board, errors, import_board, layout_text, poke

BOARD = Board(rows=6, columns=8, pokes_each=2, pitch=0.012)
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


def sentences(folder):
    return setup_sentences(SessionResults(load(folder / "s")).setup)


@pytest.mark.parametrize(("order", "what", "remedy"), ORDERS.values(), ids=ORDERS)
def test_an_exchange_is_named_and_its_remedy_gives_right_positions(frames, tmp_path, order, what, remedy):
    """Column k of the table has taxel `order[k]`; line k of the layout is that of taxel k until it is corrected."""
    import_board(tmp_path / "a", frames, frames.plain[:, order], layout=True)
    said = sentences(tmp_path / "a")
    assert len(said) == 1
    assert what in said[0]
    assert remedy in said[0]
    import_board(tmp_path / "b", frames, frames.plain[:, order], layout=True, file=layout_text(BOARD, order))
    assert sentences(tmp_path / "b") == ()
    for each in load(tmp_path / "b" / "s").snapshot().estimates[Method.MODULES]:
        assert np.linalg.norm(each.position - BOARD.places[order[each.channel]]) < 0.0005


def test_exchanged_halves_of_two_modules_are_their_first_channels(frames, tmp_path):
    order = np.roll(ALL, 24)
    import_board(tmp_path / "a", frames, frames.plain[:, order], layout=True, file=layout_text(BOARD, blocks=2))
    assert any("first_channel" in each for each in sentences(tmp_path / "a"))


def test_no_change_is_advised_that_leaves_taxels_far_from_their_places(frames, tmp_path):
    """No hypothesis explains an arbitrary order: nothing is advised."""
    order = np.random.default_rng(7).permutation(48)
    import_board(tmp_path, frames, frames.plain[:, order], layout=True)
    assert sentences(tmp_path) == ()


def test_a_right_order_is_not_doubted(frames, tmp_path):
    snapshot = import_board(tmp_path, frames, frames.plain, layout=True)
    assert sentences(tmp_path) == ()
    assert errors(snapshot, BOARD)[:, 0].mean() < 0.0008

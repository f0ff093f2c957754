"""What each poke counts, and where else a taxel may lie: in words, in the lists, on the map and in the 3D view."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from PySide6.QtCore import Qt

from app.panels.inspect_panel import InspectPanel, poke_cells
from app.panels.pokes_panel import PokesPanel
from app.panels.taxel_map import TaxelMap
from app.scene3d import scene_state
from app.scene3d.estimates import BLIND_HALF_LENGTH, EstimatesLayer
from app.scene3d.scene_state import StaticScene, View3DState
from app.text.errors_text import (
    MAX_LISTED_POKES,
    doubt_mark,
    doubt_words,
    doubting,
    miss_of,
    rival_words,
    taxel_pokes,
    weight_of,
)
from app.theme import DARK
from skincal.taxels.contact_table import ContactTable
from skincal.taxels.result import Estimate, Method, Rival, State
from tests.app.scene3d_support import contact, estimate
from tests.app.view3d_on_screen import make_plotter, points_of
from tests.app.window_support import NAMES, PLAN, SCENE, changed, frame, pixels, session, show_in, touch
from tests.approved import approved

BOTH = (Method.SURFACE, Method.FREE)


def ambiguous(channel: int = 3, odds: float = 3.2) -> Estimate:
    """A taxel that may as well lie 34 mm along x."""
    there = Rival(np.array([0.034, 0.0, 0.0]), 1, odds)
    return replace(estimate(channel, (0.0, 0.0, 0.0), Method.SURFACE), rival=there)


def doubted(channel: int = 3, **trust: float) -> Estimate:
    return replace(estimate(channel, (0.0, 0.0, 0.0)), doubted={int(poke[1:]): value for poke, value in trust.items()})


def test_an_ambiguous_taxel_says_how_far_how_likely_and_what_to_do():
    assert rival_words(ambiguous()) == approved("taxel.rival", away_mm=34, odds=3)
    assert rival_words(estimate(3, (0, 0, 0))) == ""
    assert rival_words(None) == ""


def test_the_weight_is_the_share_of_the_strongest_answer_and_what_the_methods_use():
    poke = touch(1, (2, 3, 5), (40.0, 10.0, 25.0))
    assert [weight_of(poke, channel) for channel in (2, 3, 5)] == [1.0, 0.25, 0.625]
    assert ContactTable([poke]).evidence([2, 3, 5]).weights.tolist() == [1.0, 0.25, 0.625]


@pytest.mark.parametrize("force", [(0.0, 0.0, -8.0), (3.0, 0.0, -4.0)])
def test_the_miss_is_the_distance_of_the_axis(force):
    aside = np.cross(force, (0.0, 1.0, 0.0)) / np.linalg.norm(force)
    poke = contact(1, 3, 0.014 * aside, force)
    assert miss_of(poke, estimate(3, (0.0, 0.0, 0.0))) == pytest.approx(0.014)
    assert miss_of(poke, Estimate(3, Method.FREE, State.BLIND, 1)) is None


def test_a_taxels_pokes_come_newest_first_without_those_that_were_taken_out():
    at = session(1, {3: doubted(3, p2=0.2)}, [touch(1), touch(2), touch(3), touch(4, (5,))], excluded=[3])
    pokes = taxel_pokes(at, at.estimates[Method.FREE][3])
    assert [(poke.poke, poke.weight, poke.trust) for poke in pokes] == [(2, 1.0, 0.2), (1, 1.0, 1.0)]
    assert poke_cells(pokes[0])[:3] == ("2", "1.00", "\N{CIRCLE WITH LEFT HALF BLACK} 0.20")
    assert poke_cells(pokes[1])[2] == "1"


def test_no_poke_counts_for_a_dead_taxel():
    at = session(1, {3: Estimate(3, Method.FREE, State.DEAD, 0)}, [touch(1), touch(2)], dead={3: "stuck"})
    assert taxel_pokes(at, at.estimates[Method.FREE][3]) == ()


def test_a_taxels_pokes_are_sought_no_further_than_they_are_listed():
    at = session(1, {3: doubted(3)}, [touch(poke) for poke in range(2, MAX_LISTED_POKES + 2)])
    unread = replace(at, pokes=(None, *at.pokes))
    pokes = taxel_pokes(unread, at.estimates[Method.FREE][3])
    assert [poke.poke for poke in pokes] == list(range(MAX_LISTED_POKES + 1, 1, -1))


def test_a_poke_that_counts_less_is_marked_with_the_taxel_and_the_reason():
    poke = contact(7, 3, (0.014, 0.0, 0.0))
    doubters = doubting([doubted(4, p7=0.4), doubted(3, p7=0.2), doubted(5, p7=0.9, p8=1.0)])
    assert [e.channel for e in doubters[7]] == [3, 4, 5]
    assert 8 not in doubters
    assert doubt_mark(7, doubters[7], NAMES) == "counts 0.2 for 10-03 +1"
    assert doubt_mark(7, doubters[7][2:], NAMES) == ""
    said = approved("taxel.doubted", trust="0.20", taxel="10-03", miss_mm=14.0)
    assert doubt_words(poke, doubters[7][0], NAMES) == said


def shown(qtbot, widget, size=(420, 300)):
    show_in(DARK)
    widget.resize(*size)
    qtbot.addWidget(widget)
    with qtbot.waitExposed(widget):
        widget.show()
    return widget


def test_the_list_of_pokes_marks_what_a_taxel_doubts(qtbot):
    panel = shown(qtbot, PokesPanel(NAMES))
    pokes = [touch(1), touch(2)]
    panel.show_state(frame(session(1, {3: estimate(3, (0, 0, 0))}, pokes)))
    assert panel.model.index(0, 1).data() == "\N{CHECK MARK} accepted"
    plain = pixels(panel)
    panel.show_state(frame(session(2, {3: doubted(3, p2=0.2)}, pokes)))
    assert panel.model.index(0, 1).data() == "\N{CIRCLE WITH LEFT HALF BLACK} counts 0.2 for 10-03"
    assert "its force axis is" in panel.model.index(0, 1).data(Qt.ItemDataRole.ToolTipRole)
    assert panel.model.index(1, 1).data() == "\N{CHECK MARK} accepted"
    assert changed(plain, pixels(panel)) > 50
    panel.show_state(frame(session(3, {3: doubted(3, p2=0.2)}, pokes, excluded=[2])))
    assert panel.model.index(0, 1).data() == "\N{CIRCLED MINUS} excluded"


def test_inspect_lists_weight_and_trust_and_says_where_else_a_taxel_may_lie(qtbot):
    panel = shown(qtbot, InspectPanel(BOTH, NAMES), (420, 700))
    assert not panel.pokes.isVisible()
    known = {3: replace(ambiguous(), doubted={1: 0.25})}
    panel.show_state(frame(session(1, known, [touch(1, (3, 4), (10.0, 50.0)), touch(2)]), selected=3))
    assert panel.rival.isVisible()
    assert panel.rival.text().endswith(approved("taxel.rival_advice"))
    rows = [[panel.pokes.topLevelItem(row).text(column) for column in range(4)] for row in range(2)]
    assert rows[0][:3] == ["2", "1.00", "1"]
    assert rows[1][:3] == ["1", "0.20", "\N{CIRCLE WITH LEFT HALF BLACK} 0.25"]
    with qtbot.waitSignal(panel.poke_wanted) as wanted:
        panel.pokes.itemActivated.emit(panel.pokes.topLevelItem(1), 0)
    assert wanted.args == [1]
    panel.show_state(frame(session(2, {3: estimate(3, (0, 0, 0))}, [touch(2)]), selected=3))
    assert not panel.rival.isVisible()
    assert panel.pokes.topLevelItemCount() == 1
    panel.show_state(frame(session(3), selected=4))
    assert not panel.pokes.isVisible()


@pytest.mark.parametrize("size", [(420, 300), (60, 60)], ids=["shapes", "dots"])
def test_the_map_marks_an_ambiguous_taxel_by_a_shape_of_its_own(qtbot, size):
    view = shown(qtbot, TaxelMap(SCENE, PLAN.channels, NAMES), size)
    sure = {3: estimate(3, (0, 0, 0)), 20: estimate(20, (0, 0, 0))}
    view.show_state(frame(session(1, sure)))
    before = pixels(view)
    view.show_state(frame(session(2, {**sure, 3: ambiguous()})))
    after = pixels(view)
    place = view.place_of(3).toPoint()
    near = np.s_[max(0, place.y() - 9) : place.y() + 9, max(0, place.x() - 9) : place.x() + 9]
    assert changed(before[near], after[near]) > 5
    other = view.place_of(20).toPoint()
    there = np.s_[max(0, other.y() - 9) : other.y() + 9, other.x() - 9 : other.x() + 9]
    assert changed(before[there], after[there]) == 0
    assert approved("taxel.rival_on_map") in view.tell(3)
    assert "another place" not in view.tell(20)


@pytest.fixture
def layer():
    plotter = make_plotter()
    made = EstimatesLayer(plotter, StaticScene(SCENE, None, None, PLAN.channels.tolist()))
    made.set_colours(scene_state.DARK)
    yield made
    plotter.close()


def moment(known: Estimate, generation: int, selected: int | None = 3) -> View3DState:
    return View3DState(session(generation, {known.channel: known}), None, Method.FREE, selected)


def ends(layer: EstimatesLayer) -> np.ndarray:
    return points_of(layer.alternative).reshape(-1, 2, 3)


def test_a_line_joins_the_selected_taxel_to_its_rival(layer):
    layer.show(moment(estimate(3, (0, 0, 0)), 1))
    assert not layer.alternative.actor.visibility
    layer.show(moment(ambiguous(), 2, selected=None))
    assert not layer.alternative.actor.visibility
    layer.show(moment(ambiguous(), 2))
    made = layer.alternative
    assert made.actor.visibility
    assert np.allclose(ends(layer)[0], [(0, 0, 0), (0.034, 0, 0)])
    assert np.allclose(
        np.linalg.norm(ends(layer)[1:] - [0.034, 0, 0], axis=2), np.linalg.norm(ends(layer)[1, 0] - [0.034, 0, 0])
    )
    layer.show(moment(ambiguous(), 3, selected=4))
    assert not made.actor.visibility
    layer.show(moment(ambiguous(), 4))
    assert made.actor.visibility


def test_the_line_of_a_taxel_that_is_blind_is_drawn_where_it_is_selected(layer):
    weakest = np.array([0.0, 0.6, 0.8])
    foot = np.array([0.01, 0.0, 0.0])
    blind = Estimate(3, Method.FREE, State.BLIND, 2, worst_direction=weakest, foot=foot)
    layer.show(moment(blind, 1))
    assert np.allclose(ends(layer)[0], [foot - BLIND_HALF_LENGTH * weakest, foot + BLIND_HALF_LENGTH * weakest])
    layer.show(moment(blind, 1, selected=None))
    assert not layer.alternative.actor.visibility

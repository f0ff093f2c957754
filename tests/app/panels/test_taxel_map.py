"""The flat map of the taxels: what it draws, and what the mouse and the keys find on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pyqtgraph.graphicsItems import ScatterPlotItem
from PySide6.QtCore import QEvent, QPoint, QPointF, Qt
from PySide6.QtGui import QColor, QImage, QMouseEvent, QPainter, QTransform, QWheelEvent
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication

from app.panels.taxel_map import MapCard, ModulesItem, TaxelMap, lay_out_map, mark_path, quarter_turns
from app.scene3d.camera import first_axes
from app.scene3d.scene_state import StaticScene
from app.state.policies import Mark
from app.state.view_state import ViewState
from app.theme import MODULE_HUES
from skincal.contacts.outcome import Reason
from skincal.contacts.poke_counts import PokeCounts
from skincal.model.scene import resource
from skincal.part.part import load_part
from skincal.session.snapshot import Snapshot
from skincal.words.units import ChannelNames
from tests.app.cut_texts import cut_texts
from tests.app.guide_support import guidance, target
from tests.app.scene3d_support import estimate
from tests.app.window_support import (
    METHODS,
    NAMES,
    PLAN,
    SCENE,
    changed,
    frame,
    paints_from_now,
    pixels,
    reading,
    session,
    shown,
)
from tests.approved import approved

NO_KEYS = Qt.KeyboardModifier.NoModifier


@pytest.fixture
def taxels(qtbot):
    view = shown(qtbot, TaxelMap(SCENE, PLAN.channels, NAMES))
    view.show_state(frame())
    return view


def test_the_legend_counts_the_marks_and_changes_with_them_alone(qtbot):
    card = shown(qtbot, MapCard(None, TaxelMap(SCENE, PLAN.channels, NAMES), METHODS))
    at = frame()
    card.show_state(at, is_changed=True)
    assert card.legend.accessibleDescription() == f"untouched {len(PLAN.channels)}"
    paints = paints_from_now(qtbot, card.legend)
    card.show_state(replace(at, selected=3), is_changed=False)
    qtbot.wait(30)
    assert paints.count == 0
    card.show_state(frame(session(2, {3: estimate(3, (0, 0, 0))})), is_changed=True)
    assert card.legend.accessibleDescription() == (
        f"untouched {len(PLAN.channels) - 1}, touched, error \N{LESS-THAN OR EQUAL TO} 3 mm 1"
    )
    assert card.legend.text().count(" ") == len("   "), "a line breaks between entries alone"


def test_counts_and_legend_are_not_cut_on_a_screen_of_1366_x_768(qtbot, monkeypatch):
    counts = PokeCounts(1137, 9, 3, {Reason.SLID: 96}, 12)
    monkeypatch.setattr(Snapshot, "poke_counts", counts)
    legend = [(symbol, f"touched, error above 3 mm {count}") for count, symbol in enumerate("abcdef", start=123)]
    monkeypatch.setattr("app.panels.taxel_map.legend_words", lambda *_: legend)
    card = shown(qtbot, MapCard(None, TaxelMap(SCENE, PLAN.channels, NAMES), METHODS), size=(430, 208))
    card.show_state(frame(), is_changed=True)
    qtbot.wait(30)
    assert cut_texts(card) == []
    assert card.pokes.height() >= 2 * card.pokes.fontMetrics().height()
    assert card.map.height() >= 60


def test_the_map_keeps_its_height_when_an_entry_of_the_legend_goes(qtbot, monkeypatch):
    entries = [[("a", f"touched, error above 3 mm {count}") for count in range(shown)] for shown in (6, 1, 1)]
    monkeypatch.setattr("app.panels.taxel_map.legend_words", lambda *_: entries.pop(0))
    card = shown(qtbot, MapCard(None, TaxelMap(SCENE, PLAN.channels, NAMES), METHODS), size=(430, 300))
    heights = []
    for generation in (1, 2):
        card.show_state(frame(session(generation, {3: estimate(3, (0, 0, 0))})), is_changed=True)
        qtbot.wait(30)
        heights.append(card.map.height())
    assert heights[0] == heights[1]
    # The lines above it, too.
    errors = ["errors: " + 20 * "3 mm, ", "errors: 3 mm"]
    monkeypatch.setattr("app.panels.taxel_map.skin_error_words", lambda *_: errors.pop(0))
    monkeypatch.setattr("app.panels.taxel_map.legend_words", lambda *_: [("a", "touched")])
    for _ in range(2):
        card.show_state(frame(session(2, {})), is_changed=True)
        qtbot.wait(30)
        heights.append(card.map.height())
    assert heights[1] > heights[2] == heights[3]
    monkeypatch.undo()
    # Another size needs other lines.
    card.resize(900, 300)
    card.show_state(frame(session(3, {})), is_changed=True)
    qtbot.wait(30)
    assert card.map.height() > heights[1]


def around(view: TaxelMap, channel: int, reach: int = 9) -> np.ndarray:
    place = view.place_of(channel)
    x, y = round(place.x()), round(place.y())
    return pixels(view)[y - reach : y + reach, x - reach : x + reach]


@pytest.mark.parametrize("size", [(420, 300), (900, 120), (160, 900)])
def test_a_map_of_any_shape_has_the_proportions_and_the_hand_of_the_layout(qtbot, size):
    view = shown(qtbot, TaxelMap(SCENE, PLAN.channels, NAMES), size)
    for channel in PLAN.channels.tolist():
        assert view.channel_at(view.place_of(channel)) == channel
        assert view.rect().contains(view.place_of(channel).toPoint())
    places = np.array([view.place_of(int(c)).toTuple() for c in PLAN.channels]) * [1, -1]
    plan = PLAN.places[PLAN.channels]
    drawn, real = (np.linalg.norm(at[:, None] - at, axis=2) for at in (places, plan))
    np.testing.assert_allclose(drawn, real * drawn.max() / real.max(), atol=1e-6)
    hands = [np.linalg.det(np.stack([at[1] - at[0], at[4] - at[0]])) for at in (places, plan)]
    assert np.sign(hands[0]) == np.sign(hands[1])


def test_an_answer_a_state_and_a_selection_each_change_their_taxel_alone(taxels):
    here, there = 3, 20
    before, other = around(taxels, here), around(taxels, there)
    responses = np.zeros(24)
    responses[here] = 80.0
    taxels.show_state(frame(view=reading(skin=responses)))
    answering = around(taxels, here)
    assert changed(before, answering) > 20
    taxels.show_state(frame(session(2, {here: estimate(here, (0, 0, 0))})))
    known = around(taxels, here)
    assert changed(before, known) > 20
    hue = QColor(MODULE_HUES[0]).getRgb()[:3]
    assert tuple(int(v) for v in known[9, 9, :3]) == hue
    plain = around(taxels, here, 20)
    taxels.show_state(frame(session(2, {here: estimate(here, (0, 0, 0))}), selected=here))
    assert changed(plain, around(taxels, here, 20)) > 40
    assert changed(other, around(taxels, there)) == 0
    before, at = pixels(taxels), session(2, {here: estimate(here, (0, 0, 0))})
    for unknown in (np.nan, np.inf):
        taxels.show_state(frame(at, reading(skin=np.full(24, unknown)), selected=here))
    assert changed(before, pixels(taxels)) == 0


def test_a_poke_gives_the_marks_that_it_changes_their_pixels_and_no_others(qtbot, monkeypatch):
    states = [frame(session(generation, {c: estimate(c, (0, 0, 0)) for c in range(3 * generation)})) for generation in range(6)]
    changing = shown(qtbot, TaxelMap(SCENE, PLAN.channels, NAMES))
    changing.show_state(states[0])
    looks: list[int] = []
    look_of = TaxelMap._look_of
    monkeypatch.setattr(TaxelMap, "_look_of", lambda its, rows, *rest: looks.append(len(rows)) or look_of(its, rows, *rest))
    for state in states[1:]:
        changing.show_state(state)
    assert looks == [3] * 5
    at_once = shown(qtbot, TaxelMap(SCENE, PLAN.channels, NAMES))
    at_once.show_state(states[-1])
    assert changed(pixels(changing), pixels(at_once)) == 0


def test_an_answer_and_a_mark_that_return_are_not_drawn_again(qtbot, monkeypatch):
    render, rendered = ScatterPlotItem.renderSymbol, []
    monkeypatch.setattr(ScatterPlotItem, "renderSymbol", lambda *of, **options: rendered.append(of) or render(*of, **options))

    def answer(level: float, known: int) -> ViewState:
        responses = np.where(np.isin(np.arange(24), (3, 4)), level, 0.0)
        return frame(session(1 + known, {c: estimate(c, (0, 0, 0)) for c in range(known)}), reading(skin=responses))

    states = [answer(level, known) for known in (0, 3) for level in (40.0, 80.0)]
    view = shown(qtbot, TaxelMap(SCENE, PLAN.channels, NAMES))
    for state in states:
        view.show_state(state)
    assert rendered
    for state in states:
        rendered.clear()
        view.show_state(state)
        assert rendered == []
        new = shown(qtbot, TaxelMap(SCENE, PLAN.channels, NAMES))
        new.show_state(state)
        assert changed(pixels(view), pixels(new)) == 0


def test_answers_are_drawn_between_kept_pixels_of_the_modules(qtbot, monkeypatch):
    drawn, paint = [], ModulesItem.paint
    monkeypatch.setattr(ModulesItem, "paint", lambda its, *rest: drawn.append(1) or paint(its, *rest))
    view = shown(qtbot, TaxelMap(SCENE, PLAN.channels, NAMES))
    view.show_state(frame())
    qtbot.wait(30)
    before, first = pixels(view), len(drawn)
    assert first
    for answer in (40.0, 80.0):
        responses = np.zeros(24)
        responses[3] = answer
        view.show_state(frame(view=reading(skin=responses)))
        qtbot.wait(30)
    assert changed(before, pixels(view)) > 20
    assert len(drawn) == first


def test_a_map_that_moves_and_changes_at_once_shows_all_of_it(qtbot):
    first, last = (frame(session(n, {c: estimate(c, (0, 0, 0)) for c in range(4 * n)})) for n in (1, 5))

    def changed_and_dragged(view):
        for kind, x, y in ((QEvent.Type.MouseButtonPress, 160.0, 60.0), (QEvent.Type.MouseMove, 67.7, 35.9)):
            at, left = QPointF(x, y), Qt.MouseButton.LeftButton
            QApplication.sendEvent(view.viewport(), QMouseEvent(kind, at, view.mapToGlobal(at), left, left, NO_KEYS))
        view.show_state(last)
        qtbot.wait(30)
        return pixels(view)

    view, other = (shown(qtbot, TaxelMap(SCENE, PLAN.channels, NAMES), (300, 90)) for _ in range(2))
    for each, state in ((view, first), (other, last)):
        each.show_state(state)
        each.zoom(3.0, QPointF(40.0, 40.0))
    qtbot.wait(30)
    before = pixels(view)
    after = changed_and_dragged(view)
    assert changed(before, after) > 1000
    assert changed(after, changed_and_dragged(other)) == 0


def test_a_map_that_is_resized_keeps_the_look_of_its_modules(qtbot, monkeypatch):
    view = shown(qtbot, TaxelMap(SCENE, PLAN.channels, NAMES), (420, 300))
    painted: list[object] = []
    paint = TaxelMap._paint_modules
    monkeypatch.setattr(TaxelMap, "_paint_modules", lambda its, colours: painted.append(colours) or paint(its, colours))
    view.resize(700, 500)
    qtbot.wait(30)
    assert painted == []
    assert changed(pixels(view), pixels(shown(qtbot, TaxelMap(SCENE, PLAN.channels, NAMES), (700, 500)))) == 0


@pytest.mark.usefixtures("qapp")
def test_states_differ_in_shape_not_only_in_colour():
    drawn = []
    for mark in Mark:
        image = QImage(40, 40, QImage.Format.Format_RGBA8888)
        image.fill(Qt.GlobalColor.black)
        painter = QPainter(image)
        painter.fillPath(QTransform().translate(20, 20).scale(24, 24).map(mark_path(mark)), QColor("white"))
        painter.end()
        drawn.append(np.frombuffer(image.constBits(), np.uint8).reshape(40, 40, 4)[..., 0] > 128)
    for i, picture in enumerate(drawn):
        for other in drawn[i + 1 :]:
            assert (picture != other).sum() > 60


def test_small_marks_differ_in_strength(qtbot):
    view = shown(qtbot, TaxelMap(SCENE, PLAN.channels, NAMES), (150, 60))
    known = {3: estimate(3, (0, 0, 0)), 4: estimate(4, (0, 0, 0), sd=0.02)}
    view.show_state(frame(session(1, known)))
    reds = [around(view, channel, 3)[..., :3].max(axis=(0, 1)).sum() for channel in (3, 4, 5)]
    assert reds[0] > reds[1] + 20 > reds[2] + 40


def test_click_hover_and_arrow_keys_find_taxels(qtbot, taxels):
    with qtbot.waitSignal(taxels.taxel_clicked) as clicked:
        QTest.mouseClick(taxels.viewport(), Qt.MouseButton.LeftButton, pos=taxels.place_of(5).toPoint())
    assert clicked.args == [5]
    assert taxels.tell(5).startswith("taxel 5, number 5 of module 10\nuntouched")
    taxels.show_state(frame(selected=3))
    with qtbot.waitSignal(taxels.taxel_clicked) as moved:
        QTest.keyClick(taxels, Qt.Key.Key_Left)
    assert taxels.place_of(moved.args[0]).x() < taxels.place_of(3).x()
    with qtbot.assertNotEmitted(taxels.taxel_clicked):
        QTest.mouseClick(taxels.viewport(), Qt.MouseButton.LeftButton, pos=QPoint(1, 1))


@pytest.mark.parametrize("name", ["flat-patch", "icub-forearm"])
def test_the_map_lies_as_the_part_is_seen_first(name):
    part = load_part(resource(f"scenes/{name}/scene.toml"))
    static = StaticScene(part)
    right, up, back = first_axes(static.extent, static.facing)
    drawn = lay_out_map(part.scene.skin.layout, part.channels, quarter_turns(static)).places
    seen = static.normals @ back > 0.3
    on_part = (static.places @ np.stack([right, up]).T)[seen]
    for way in range(2):
        assert np.corrcoef(drawn[seen, way], on_part[:, way])[0, 1] > 0.7


def test_the_map_comes_nearer_by_wheel_and_keys_moves_along_and_comes_back(qtbot, taxels):
    def places():
        return np.array([taxels.place_of(int(c)).toTuple() for c in PLAN.channels])

    def turn_wheel(at, notches):
        none, plain, phase = Qt.MouseButton.NoButton, Qt.KeyboardModifier.NoModifier, Qt.ScrollPhase.NoScrollPhase
        event = QWheelEvent(at, at, QPoint(), QPoint(0, 120 * notches), none, plain, phase, False)
        QApplication.sendEvent(taxels.viewport(), event)

    whole, first = places(), pixels(taxels)
    under = taxels.place_of(9)
    turn_wheel(under, 2)
    grown = np.linalg.norm(places()[9] - places()[12]) / np.linalg.norm(whole[9] - whole[12])
    assert grown == pytest.approx(1.25**2)
    assert abs(places()[9, 0] - under.x()) < 1e-6, "it stays under the pointer"
    with qtbot.assertNotEmitted(taxels.taxel_clicked):
        before, start = places(), QPoint(2, 2)
        QTest.mousePress(taxels.viewport(), Qt.MouseButton.LeftButton, pos=start)
        drag = QMouseEvent(
            QEvent.Type.MouseMove, QPointF(9, 2), QPointF(9, 2), Qt.MouseButton.NoButton, Qt.MouseButton.LeftButton,
            Qt.KeyboardModifier.NoModifier,
        )  # fmt: skip
        QApplication.sendEvent(taxels.viewport(), drag)
        QTest.mouseRelease(taxels.viewport(), Qt.MouseButton.LeftButton, pos=start)
    np.testing.assert_allclose((places() - before)[:, 0], 7.0)
    QTest.keyClick(taxels, Qt.Key.Key_0)
    np.testing.assert_allclose(places(), whole)
    assert changed(first, pixels(taxels)) == 0
    for _ in range(12):
        QTest.keyClick(taxels, Qt.Key.Key_Plus)
    outside = [c for c in range(24) if not taxels.rect().contains(taxels.place_of(c).toPoint())]
    taxels.show_state(frame(selected=outside[0]))
    assert taxels.rect().contains(taxels.place_of(outside[0]).toPoint()), "what is selected comes into the picture"
    for _ in range(20):
        QTest.keyClick(taxels, Qt.Key.Key_Minus)
    np.testing.assert_allclose(places(), whole)


def framed(says, generation: int = 1):
    at = frame(session(generation, {c: estimate(c, (0, 0, 0)) for c in (2, 3, 15)}))
    return replace(at, guidance=says)


def near(view: TaxelMap, channel: int, reach: int) -> tuple[slice, slice]:
    place = view.place_of(channel).toPoint()
    return np.s_[max(0, place.y() - reach) : place.y() + reach, max(0, place.x() - reach) : place.x() + reach]


def test_the_map_rings_the_target_and_no_other(qtbot, taxels):
    taxels.show_state(framed(guidance()))
    before = pixels(taxels)
    taxels.show_state(framed(guidance(target(3))))
    after = pixels(taxels)
    assert changed(before[near(taxels, 3, 24)], after[near(taxels, 3, 24)]) > 60
    assert changed(before[near(taxels, 15, 12)], after[near(taxels, 15, 12)]) == 0
    ring = after[near(taxels, 3, 24)][(before != after)[near(taxels, 3, 24)].any(axis=2)][:, :3].astype(int)
    assert (ring.min(axis=1) > 240).any()
    assert (ring.max(axis=1) < 15).any()
    paints = paints_from_now(qtbot, taxels)
    taxels.show_state(framed(guidance(target(3))))
    qtbot.wait(30)
    assert paints.count == 0, "the same target is drawn no second time"
    taxels.show_state(framed(guidance(target(15))))
    qtbot.wait(30)
    assert paints.count == 1


def test_a_target_that_is_not_on_the_map_is_left_out_and_a_skin_without_layout_has_all_channels(qtbot):
    half = shown(qtbot, TaxelMap(SCENE, PLAN.channels[:12], NAMES))
    half.show_state(framed(guidance()))
    before = pixels(half)
    half.show_state(framed(guidance(target(20))))
    assert np.array_equal(pixels(half), before)
    bare = replace(SCENE, skin=replace(SCENE.skin, layout=None))
    view = shown(qtbot, TaxelMap(bare, np.arange(24), ChannelNames(None)))
    view.show_state(frame(where=bare))
    assert len({view.place_of(c).toTuple() for c in range(24)}) == 24
    assert view.tell(7).startswith("taxel 7")


def test_a_done_taxel_is_shown_by_shape_and_what_is_missing_by_words(taxels):
    taxels.show_state(framed(guidance()))
    good = pixels(taxels)
    taxels.show_state(framed(guidance(done=(3,)), 2))
    done = pixels(taxels)
    assert changed(good[near(taxels, 3, 12)], done[near(taxels, 3, 12)]) > 10
    assert changed(good[near(taxels, 15, 12)], done[near(taxels, 15, 12)]) == 0
    assert "finished" in taxels.tell(3)
    assert approved("guide.needs") in taxels.tell(15)
    taxels.show_state(framed(None, 2))
    assert np.array_equal(good[near(taxels, 3, 12)], pixels(taxels)[near(taxels, 3, 12)]), "without a guide it is good"
    assert "needs" not in taxels.tell(15)

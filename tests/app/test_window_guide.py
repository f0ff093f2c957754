"""The guide in the window: the target in the 3D view, the turning camera, the words, and the switches that are kept."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from PySide6.QtCore import QSettings, Qt
from PySide6.QtTest import QTest

from app.panels.inspect_panel import InspectPanel
from app.panels.widgets import FittedLabel
from app.session.opening import OpenRequest
from skincal.contacts.outcome import PressPhase
from skincal.following.session_guide import ModulesEnough
from skincal.guide.guidance import Target
from skincal.taxels.result import Method
from tests.app.guide_support import guidance, target
from tests.app.scene3d_support import estimate, laid, tick_of
from tests.app.view3d_on_screen import (
    KEPT,
    Drawn,
    canvas_of,
    drag,
    make_view,
    points_of,
    renderer_of,
    screen_place,
    settle,
    wheel,
)
from tests.app.view3d_on_screen import pixels as picture
from tests.app.whole_window import Bench
from tests.app.window_support import PLAN, changed, context, frame, is_elided, paints_from_now, pixels, reading, session
from tests.approved import approved

Key = Qt.Key


CLOCK = SimpleNamespace(now_s=0.0)
"""Clock of the view, which only `ticks` advances: a busy machine turns a view as often as a quiet one."""
TICK_S = 0.02


@pytest.fixture
def view(qtbot, monkeypatch):
    monkeypatch.setattr("app.scene3d.view.time", SimpleNamespace(monotonic=lambda: CLOCK.now_s))
    CLOCK.now_s = 1000.0
    yield make_view(qtbot)
    KEPT.clear()


@pytest.mark.parametrize("dark", [True, False])
def test_the_target_is_black_and_white_in_both_themes_and_leaves_no_trace(view, dark):
    view.set_dark(dark)
    at = session(1, {3: estimate(3, laid(PLAN).places[3])})
    view.show_state(tick_of(at, None, Method.FREE, None))
    without, (x, y) = picture(view).astype(int), (round(v) for v in screen_place(view, 3))
    assert view.show_state(tick_of(at, None, Method.FREE, None, target(3)))
    shown = picture(view).astype(int)
    differs = np.abs(shown - without).max(axis=2) > 25
    new = shown[differs]
    assert (new.min(axis=1) > 230).sum() > 50
    assert (new.max(axis=1) < 30).sum() > 50
    # The ring is around the taxel: part of it on each side.
    for side in (np.s_[y - 60 : y, x - 5 : x + 5], np.s_[y : y + 60, x - 5 : x + 5]):
        assert differs[side].any()
    drawn = Drawn(view)
    assert not view.show_state(tick_of(at, None, Method.FREE, None, target(3)))
    settle()
    assert drawn.count == 0, "the same target asks for no picture"
    assert view.show_state(tick_of(at, None, Method.FREE, None))
    assert np.abs(picture(view) - without).max() < 3


def below(channel: int = 3) -> Target:
    """A poke into the lower side of the box, which the camera does not see."""
    place = laid(PLAN).places[channel] + np.array([0.0, 0.0, -0.02])
    return target(channel, place=place, normal=np.array([0.0, 0.0, -1.0]), push=np.array([0.0, 0.0, 1.0]))


def ticks(view, seconds: float, live=None) -> int:
    """Show the same moment as the window's ticks do; return how often the picture changed."""
    count, at = 0, session(1)
    for _ in range(round(seconds / TICK_S)):
        count += view.show_state(tick_of(at, live, Method.FREE, None, below()))
        settle()
        CLOCK.now_s += TICK_S
    return count


def camera_of(view) -> np.ndarray:
    return np.array(renderer_of(view).renderer.GetActiveCamera().GetPosition())


def test_the_view_turns_to_a_hidden_target_once_and_draws_it_at_once(view):
    before = camera_of(view)
    assert before[2] > 0
    assert ticks(view, 0.1) > 0
    np.testing.assert_allclose(points_of(renderer_of(view).target.ring).mean(axis=0)[2], -0.02, atol=1e-6)
    assert ticks(view, 0.5) > 10
    assert camera_of(view)[2] < 0
    drawn = Drawn(view)
    assert ticks(view, 0.2) == drawn.count == 0
    view.reset_camera()
    np.testing.assert_allclose(camera_of(view), before)
    assert ticks(view, 0.5) == 0, "this target turns it no more"


@pytest.mark.parametrize(
    "move",
    [lambda v: drag(canvas_of(v), Qt.MouseButton.LeftButton), lambda v: wheel(canvas_of(v), 120), lambda v: v.reset_camera()],
)
def test_a_manual_move_ends_a_turn_of_the_view(view, move):
    assert ticks(view, 0.12) > 0
    move(view)
    before = camera_of(view)
    assert ticks(view, 0.5) == 0
    np.testing.assert_array_equal(camera_of(view), before)


def test_the_view_turns_neither_in_contact_nor_under_the_mouse_nor_if_it_is_switched_off(view):
    before = camera_of(view)
    ticks(view, 0.5, reading(PressPhase.PRESSING, 8.0))
    np.testing.assert_array_equal(camera_of(view), before)
    QTest.mousePress(canvas_of(view), Qt.MouseButton.LeftButton)
    ticks(view, 0.5)
    np.testing.assert_array_equal(camera_of(view), before)
    QTest.mouseRelease(canvas_of(view), Qt.MouseButton.LeftButton)
    view.set_turning(False)
    ticks(view, 0.5)
    np.testing.assert_array_equal(camera_of(view), before)
    view.set_turning(True)
    assert ticks(view, 0.5) > 10
    assert camera_of(view)[2] < 0


def test_the_taxel_tab_tells_what_the_selected_taxel_needs(qtbot):
    panel = InspectPanel(context(methods=(Method.FREE,)))
    qtbot.addWidget(panel)
    base = frame(session(1, {c: estimate(c, (0, 0, 0)) for c in (2, 3, 15)}), selected=3)
    for generation, (says, words) in enumerate(
        ((guidance(), approved("guide.selected_needs")), (guidance(done=(3,)), ""), (None, ""))
    ):
        panel.show_state(replace(base, guidance=says, snapshot=replace(base.snapshot, generation=generation)))
        assert panel.reason.text() == words


def test_large_type_becomes_smaller_before_it_is_cut(qtbot):
    label = FittedLabel()
    font = label.font()
    font.setPointSizeF(20.0)
    label.setFont(font)
    qtbot.addWidget(label)
    label.resize(300, 40)
    label.setText("poke 17-04")
    assert label.fitted().pointSizeF() == 20.0
    label.resize(label.fontMetrics().horizontalAdvance("poke 17-04 straight") - 10, 40)
    label.setText("poke 17-04 straight")
    assert 15.0 <= label.fitted().pointSizeF() < 20.0
    assert not is_elided(label)
    label.setText("poke 17-04 straight " * 9)
    assert label.fitted().pointSizeF() == 15.0
    assert is_elided(label)


# In the window


def test_a_session_is_guided_as_soon_as_it_is_open(bench, qtbot, recorded, monkeypatch):
    bench.open(OpenRequest(session=recorded))
    bench.until_all_is_there()
    session_view = bench.window.session_view
    workspace, first = session_view.workspace, session_view.state.target
    assert first is not None
    view, on_map = pixels(workspace.view), pixels(workspace.map)
    bench.key(Key.Key_G)
    assert session_view.state.guidance is None
    assert changed(view, pixels(workspace.view)) > 100
    assert changed(on_map, pixels(workspace.map)) > 60
    bench.key(Key.Key_G)
    assert session_view.state.target.channel == first.channel
    assert changed(view, pixels(workspace.view)) == changed(on_map, pixels(workspace.map)) == 0
    for method in (Method.MODULES, Method.SURFACE, Method.FREE):
        assert session_view.state.guidance.method is method
        before, on_map = session_view.state.target, pixels(workspace.map)
        bench.key(Key.Key_N)
        assert session_view.state.target.channel != before.channel
        assert changed(on_map, pixels(workspace.map)) > 60
        bench.key(Key.Key_V)
    assert session_view.state.guidance.method is Method.MODULES
    assert session_view.state.target.channel != first.channel, "a skipped target stays skipped"
    again = session_view.state.guidance
    session_view.follow_again()
    assert session_view.state.guidance is again
    decided = bench.snapshot.decisions.closings, bench.snapshot.history.entries
    session_view.check_again()
    assert (bench.snapshot.decisions.closings, bench.snapshot.history.entries) == decided, "there is nothing to check"
    # That the modules method needs no more pokes is said until that method is shown.
    bench.window.messages.dismiss()
    bench.key(Key.Key_V)
    with monkeypatch.context() as enough:
        enough.setattr(ModulesEnough, "is_news", lambda *_, **__: True)
        session_view.follow_again()
    bench.until(lambda: approved("modules_check.pokes_on_every_module") in bench.window.messages.text.text(), 5000)
    for _ in range(2):
        bench.key(Key.Key_V)
    assert session_view.state.method is Method.MODULES
    bench.until(lambda: not bench.window.messages.isVisible(), 5000)
    bench.window.messages.dismiss()
    paints = paints_from_now(qtbot, bench.window)
    qtbot.wait(1200)
    assert paints.count == 0


def switches(bench) -> tuple[bool, bool, bool, bool]:
    """Whether turning, ellipses, lines to another method and guide are on, as the views have them."""
    bench.until_all_is_there()
    session_view = bench.window.session_view
    renderer = renderer_of(session_view.workspace.view)
    (ellipses,) = (layer for layer in renderer.layers if layer.name == "uncertainty")
    difference, guided = renderer.estimates.difference, session_view.state.guidance is not None
    shown = renderer.auto_camera.wanted, not ellipses.lines.hidden, difference, guided
    actions = bench.window.commands.actions
    assert shown == tuple(actions[name].isChecked() for name in ("turn", "uncertainty", "difference", "guide"))
    return shown


def test_switches_hold_for_the_next_session_and_all_but_one_for_the_next_window(bench, qtbot, tmp_path, recorded):
    bench.open(OpenRequest(session=recorded))
    assert switches(bench) == (True, True, False, True)
    for key, modifier in (
        (Key.Key_T, None),
        (Key.Key_4, Qt.KeyboardModifier.ControlModifier),
        (Key.Key_X, None),
        (Key.Key_G, None),
    ):
        bench.key(key, modifier or Qt.KeyboardModifier.NoModifier)
    assert switches(bench) == (False, False, True, False)
    bench.open(OpenRequest(session=recorded))
    assert switches(bench) == (False, False, True, False)
    bench.window.close()
    QSettings("skincal", "test").sync()
    other = Bench(qtbot, tmp_path / "again")
    other.open(OpenRequest(session=recorded))
    assert switches(other) == (False, False, False, False)
    other.key(Key.Key_4, Qt.KeyboardModifier.ControlModifier)
    assert switches(other) == (False, True, False, False)
    other.window.close()


def test_the_target_is_told_and_not_cut_at_1280_by_720(bench):
    bench.open_served()
    now, session_view = bench.window.session_view.workspace.now, bench.window.session_view
    bench.key(Key.Key_V)
    bench.until(lambda: now.headline.text().startswith("Press the landmark "))
    bench.key(Key.Key_N, Qt.KeyboardModifier.ShiftModifier)
    bench.until(
        lambda: session_view.state.target.channel is not None and now.headline.text().startswith(("Press taxel ", "Zeroing"))
    )
    assert session_view.workspace.names.short(session_view.state.target.channel) in now.headline.text() + now.detail.text()
    assert (bench.window.width(), bench.window.height()) == (1280, 720)
    for longest in (approved("guide.away", taxel="24-11", degrees=28, neighbour="24-03"), approved("guide.enough", count=84)):
        now.headline.setText(longest)
        assert not is_elided(now.headline)
    left = approved("guide.pokes_left", pokes=1240, minutes=46)
    longest = "  \N{MIDDLE DOT}  ".join([approved("guide.one_more"), "4200 of 4200 taxels finished", left])
    assert now.detail.fontMetrics().horizontalAdvance(longest) <= now.detail.width()

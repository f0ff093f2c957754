"""What the guide draws: the target in the 3D view and on the map, and the whole window that is guided, on a real display."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
from PySide6.QtCore import QSettings, Qt
from PySide6.QtGui import QImage
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QMainWindow

from app.panels.inspect_panel import InspectPanel
from app.panels.widgets import FittedLabel
from app.scene3d.canvas import Canvas
from app.scene3d.view import View3D
from app.session.opening import OpenRequest
from app.theme import Choice
from skincal.contacts.outcome import PressPhase
from skincal.guide.guidance import Target
from skincal.taxels.result import Method
from tests.app.guide_support import guidance, target
from tests.app.scene3d_support import box, estimate, laid
from tests.app.view3d_on_screen import canvas_of, drag, points_of, renderer_of, screen_place, wheel
from tests.app.whole_window import Bench, Paints
from tests.app.window_support import NAMES, PLAN, SCENE, changed, frame, is_elided, pixels, reading, session
from tests.approved import approved


@pytest.fixture
def view(qtbot):
    window = QMainWindow()
    made = View3D(window, Canvas.RASTER)
    window.setCentralWidget(made)
    window.resize(640, 480)
    qtbot.addWidget(window, before_close_func=lambda _: made.close_view())
    with qtbot.waitExposed(window):
        window.show()
    with qtbot.waitSignal(made.ready, timeout=60_000):
        made.begin(SCENE, box(), laid(PLAN), range(24))
    settle()
    yield made
    window.close()


def settle():
    for _ in range(4):
        QApplication.processEvents()


def seen(view) -> np.ndarray:
    settle()
    image = view.window().grab().toImage().convertToFormat(QImage.Format.Format_RGB888)
    rows = np.frombuffer(image.constBits(), np.uint8).reshape(image.height(), image.bytesPerLine())
    return rows[:, : 3 * image.width()].reshape(image.height(), image.width(), 3).astype(int)


@pytest.mark.parametrize("dark", [True, False])
def test_the_target_is_black_and_white_in_both_themes_and_goes_without_a_trace(view, dark):
    view.set_dark(dark)
    at = session(1, {3: estimate(3, laid(PLAN).places[3])})
    view.show_moment(at, None, Method.FREE, None)
    without, place = seen(view), screen_place(view, 3)
    assert view.show_moment(at, None, Method.FREE, None, target(3))
    shown = seen(view)
    x, y = (round(v) for v in place)
    new = shown[np.abs(shown - without).max(axis=2) > 25]
    assert (new.min(axis=1) > 230).sum() > 50
    assert (new.max(axis=1) < 30).sum() > 50
    # The ring is around the taxel: something of it on each side.
    differs = np.abs(shown - without).max(axis=2) > 25
    for side in (np.s_[y - 60 : y, x - 5 : x + 5], np.s_[y : y + 60, x - 5 : x + 5]):
        assert differs[side].any()
    assert view.show_moment(at, None, Method.FREE, None)
    assert np.abs(seen(view) - without).max() < 3


def test_the_same_target_asks_for_no_picture(view):
    drawn = []
    renderer_of(view).renderer.AddObserver("EndEvent", lambda *_: drawn.append(1))
    assert view.show_moment(session(1), None, Method.FREE, None, target(3))
    settle()
    count = len(drawn)
    assert not view.show_moment(session(1), None, Method.FREE, None, target(3))
    settle()
    assert len(drawn) == count


def below(channel: int = 3) -> Target:
    """A poke into the lower side of the box, which nobody sees."""
    place = laid(PLAN).places[channel] + np.array([0.0, 0.0, -0.02])
    return target(channel, place=place, normal=np.array([0.0, 0.0, -1.0]), push=np.array([0.0, 0.0, 1.0]))


def ticks(view, at, seconds: float, view_of=None) -> int:
    """Show the same moment as the window's ticks do; return how often the picture changed."""
    count, end = 0, time.monotonic() + seconds
    while time.monotonic() < end:
        count += view.show_moment(at, view_of, Method.FREE, None, below())
        settle()
        time.sleep(0.02)
    return count


def camera_of(view) -> np.ndarray:
    return np.array(renderer_of(view).renderer.GetActiveCamera().GetPosition())


def test_the_view_turns_to_a_target_that_nobody_sees_and_then_rests(view):
    at = session(1)
    before = camera_of(view)
    assert before[2] > 0
    assert ticks(view, at, 0.5) > 3
    assert camera_of(view)[2] < 0
    drawn = []
    renderer_of(view).renderer.AddObserver("EndEvent", lambda *_: drawn.append(1))
    assert ticks(view, at, 0.2) == 0
    assert not drawn
    # The whole part again: this target turns it no more.
    view.reset_camera()
    np.testing.assert_allclose(camera_of(view), before)
    assert ticks(view, at, 0.5) == 0


@pytest.mark.parametrize(
    "move",
    [lambda v: drag(canvas_of(v), Qt.MouseButton.LeftButton), lambda v: wheel(canvas_of(v), 120), lambda v: v.reset_camera()],
)
def test_a_hand_ends_a_turn_of_the_view(view, move):
    assert ticks(view, session(1), 0.12) > 0
    move(view)
    before = camera_of(view)
    assert ticks(view, session(1), 0.5) == 0
    np.testing.assert_array_equal(camera_of(view), before)


def test_the_view_turns_neither_in_contact_nor_under_the_mouse_nor_where_it_is_switched_off(view):
    at, pressing = session(1), reading(PressPhase.PRESSING, 8.0)
    before = camera_of(view)
    ticks(view, at, 0.5, pressing)
    np.testing.assert_array_equal(camera_of(view), before)
    QTest.mousePress(canvas_of(view), Qt.MouseButton.LeftButton)
    ticks(view, at, 0.5)
    np.testing.assert_array_equal(camera_of(view), before)
    QTest.mouseRelease(canvas_of(view), Qt.MouseButton.LeftButton)
    view.set_turning(False)
    ticks(view, at, 0.5)
    np.testing.assert_array_equal(camera_of(view), before)
    view.set_turning(True)
    assert ticks(view, at, 0.5) > 3
    assert camera_of(view)[2] < 0


def test_a_new_target_is_drawn_at_once_though_the_camera_turns(view):
    ticks(view, session(1), 0.1)
    layer = renderer_of(view).target
    assert layer is not None
    np.testing.assert_allclose(points_of(layer.ring).mean(axis=0)[2], -0.02, atol=1e-6)


def framed(says, generation: int = 1):
    at = frame(session(generation, {c: estimate(c, (0, 0, 0)) for c in (2, 3, 15)}))
    return replace(at, guidance=says)


def test_the_taxel_tab_says_what_the_selected_taxel_still_needs(qtbot):
    panel = InspectPanel((Method.FREE,), NAMES)
    qtbot.addWidget(panel)
    for says, last in ((guidance(), approved("guide.selected_needs")), (guidance(done=(3,)), "")):
        panel.show_state(replace(framed(says, 1 + len(last)), selected=3))
        assert panel.reason.text() == last
    panel.show_state(replace(framed(guidance(), 9), selected=3))
    assert "needs" in panel.reason.text()
    panel.show_state(replace(framed(None, 9), selected=3))
    assert "needs" not in panel.reason.text(), "nobody guides any more"


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


def test_a_session_is_guided_as_soon_as_it_is_open(bench, qtbot, recorded):
    bench.open(OpenRequest(session=recorded))
    bench.until_all_is_there()
    session_view = bench.window.session_view
    first = session_view.state.target
    assert first is not None
    assert "target" in session_view.workspace.view.list_layers()
    view, on_map = pixels(session_view.workspace.view), pixels(session_view.workspace.map)

    bench.key(Qt.Key.Key_G)
    assert session_view.state.guidance is None
    assert changed(view, pixels(session_view.workspace.view)) > 100
    assert changed(on_map, pixels(session_view.workspace.map)) > 60
    bench.key(Qt.Key.Key_G)
    assert session_view.state.target.channel == first.channel
    assert changed(view, pixels(session_view.workspace.view)) == 0
    assert changed(on_map, pixels(session_view.workspace.map)) == 0

    for method in (Method.MODULES, Method.SURFACE, Method.FREE):
        assert session_view.state.guidance.method is method
        before, on_map = session_view.state.target, pixels(session_view.workspace.map)
        bench.key(Qt.Key.Key_N)
        assert session_view.state.target.channel != before.channel
        assert changed(on_map, pixels(session_view.workspace.map)) > 60
        bench.key(Qt.Key.Key_V)
    assert session_view.state.guidance.method is Method.MODULES
    assert session_view.state.target.channel != first.channel, "what was skipped stays skipped"
    again = session_view.state.guidance
    session_view.follow_again()
    assert session_view.state.guidance is again, "nothing is worked out where nothing changed"

    paints = Paints(bench.window)
    qtbot.wait(1200)
    assert paints.count == 0


def test_a_closing_check_of_nothing_is_no_step(bench, recorded):
    bench.open(OpenRequest(session=recorded))
    before = bench.snapshot
    bench.window.session_view.check_again()
    assert (bench.snapshot.decisions.closings, bench.snapshot.history.entries) == (
        before.decisions.closings,
        before.history.entries,
    )


def test_turning_and_layers_are_choices_of_the_menus_that_are_remembered(bench, qtbot, tmp_path, recorded):
    bench.open(OpenRequest(session=recorded))
    bench.until_all_is_there()
    assert bench.window.commands.actions["turn"].isChecked()
    assert renderer_of(bench.window.session_view.workspace.view).auto_camera.wanted
    bench.key(Qt.Key.Key_T)
    assert not renderer_of(bench.window.session_view.workspace.view).auto_camera.wanted
    bench.key(Qt.Key.Key_4, Qt.KeyboardModifier.ControlModifier)
    assert ellipses_drawn(bench) == 0
    bench.window.close()
    QSettings("skincal", "test").sync()
    other = Bench(qtbot, tmp_path / "again")
    other.open(OpenRequest(session=recorded))
    other.until_all_is_there()
    assert not other.window.commands.actions["turn"].isChecked()
    assert not renderer_of(other.window.session_view.workspace.view).auto_camera.wanted
    assert ellipses_drawn(other) == 0
    other.key(Qt.Key.Key_4, Qt.KeyboardModifier.ControlModifier)
    assert ellipses_drawn(other) == 1
    other.window.close()


def test_lines_to_another_method_stay_when_another_session_is_opened(bench, recorded):
    def wanted() -> bool:
        bench.until_all_is_there()
        return bench.window.session_view.workspace.view._state.difference

    bench.open(OpenRequest(session=recorded))
    assert not wanted()
    bench.window.commands.actions["difference"].trigger()
    assert wanted()
    bench.open(OpenRequest(session=recorded))
    assert bench.window.commands.actions["difference"].isChecked()
    assert wanted()


def ellipses_drawn(bench):
    """How many meshes of regions are in the picture."""
    renderer = renderer_of(bench.window.session_view.workspace.view)
    (layer,) = (layer for layer in renderer.layers if layer.name == "uncertainty")
    return int(not layer.lines.hidden)


def test_the_guide_stays_off_where_it_was_switched_off(bench, qtbot, tmp_path, recorded):
    bench.open(OpenRequest(session=recorded))
    bench.until_all_is_there()
    assert bench.window.commands.actions["guide"].isChecked()
    bench.key(Qt.Key.Key_G)
    bench.window.close()
    QSettings("skincal", "test").sync()
    other = Bench(qtbot, tmp_path / "again")
    other.open(OpenRequest(session=recorded))
    assert not other.window.commands.actions["guide"].isChecked()
    assert other.window.session_view.state.guidance is None
    other.window.close()


@pytest.mark.parametrize("choice", [Choice.DARK, Choice.LIGHT])
def test_what_to_poke_is_said_and_not_cut_at_1280_by_720(bench, choice):
    bench.theme.choose(choice)
    bench.open_served()
    now = bench.window.session_view.workspace.now
    bench.key(Qt.Key.Key_V)
    bench.until(lambda: now.headline.text().startswith("Press the landmark "))
    bench.key(Qt.Key.Key_N, Qt.KeyboardModifier.ShiftModifier)
    bench.until(lambda: bench.window.session_view.state.target.channel is not None and now.headline.text().startswith("poke "))
    asked = bench.window.session_view.state.target
    assert bench.window.session_view.workspace.names.short(asked.channel) in now.headline.text()
    assert (bench.window.width(), bench.window.height()) == (1280, 720)
    for longest in (
        approved("guide.away", taxel="24-11", degrees=28, neighbour="24-03"),
        approved("guide.enough", count=84),
    ):
        now.headline.setText(longest)
        assert not is_elided(now.headline)
    reason = approved("guide.one_more")
    longest = "  \N{MIDDLE DOT}  ".join(
        [reason, "4200 of 4200 taxels finished", approved("guide.pokes_left", pokes=1240, minutes=46)]
    )
    assert now.detail.fontMetrics().horizontalAdvance(longest) <= now.detail.width()

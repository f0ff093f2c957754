"""The 3D view on a real (virtual) display: what its pixels show, when it draws, what a click means, what it leaves behind."""

from __future__ import annotations

import gc
import threading
import weakref
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shiboken6
from PySide6.QtCore import QEvent, QPoint, Qt, QTimer
from PySide6.QtGui import QImage
from PySide6.QtWidgets import QApplication, QLabel, QMainWindow

from app.commands import LAYER_NAMES
from app.scene3d import canvas
from app.scene3d.axes import MAX_DRAWN_FORCE_AXES
from app.scene3d.camera import pose_of
from app.scene3d.canvas import Canvas
from app.scene3d.estimates import UNKNOWN_DEPTH_HALF_LENGTH_M
from app.scene3d.scene_state import DARK, LIGHT, MODULE_RGB, StaticScene
from app.scene3d.view import View3D
from skincal.guide.guidance import Target
from skincal.model.errors import InputError
from skincal.model.scene import Landmark
from skincal.part.part import Part
from skincal.taxels.result import Estimate, Method, Rival, State
from tests.app.scene3d_support import box, contact, decided, estimate, laid, layout, live, project, scene, snapshot, tick_of
from tests.app.view3d_on_screen import (
    KEPT,
    Drawn,
    around,
    canvas_of,
    drag,
    make_view,
    pixels,
    points_of,
    renderer_of,
    screen_place,
    settle,
    turn,
    wheel,
)

PLAN = layout()
EVERY = ("surface", "modules", "estimates", "axes", "uncertainty", "target", "landmarks", "compare", "hints", "robot")


@pytest.fixture(autouse=True)
def _windows():
    yield
    KEPT.clear()


@pytest.fixture
def view(qtbot):
    return make_view(qtbot)


def test_every_layer_exists_that_the_scene_supports_and_no_other(qtbot):
    assert make_view(qtbot).list_layers() == EVERY
    bare = make_view(qtbot, surface=False, plan=False)
    assert bare.list_layers() == EVERY[2:]
    assert make_view(qtbot, surface=False).list_layers() == EVERY[1:]


def test_a_moved_estimate_leaves_its_place_and_appears_at_the_new_one(view):
    view.show_state(tick_of(snapshot(1, {3: estimate(3, (-0.018, 0.005, 0.002))})))
    before, old = pixels(view), screen_place(view, 3)
    assert view.show_state(tick_of(snapshot(2, {3: estimate(3, (0.02, -0.02, 0.002))})))
    after, new = pixels(view), screen_place(view, 3)
    assert np.hypot(old[0] - new[0], old[1] - new[1]) > 60
    for place in (old, new):
        changed = np.abs(around(before, place) - around(after, place)).max(axis=-1) > 25
        assert changed.mean() > 0.5
    hue = MODULE_RGB[0].astype(int)
    # Lit from the camera, the middle of a ball has its module's hue at nearly full strength.
    assert np.abs(around(after, new, 2) - hue).max() < 60
    assert np.abs(around(before, old, 2) - hue).max() < 60
    np.testing.assert_array_equal(before[:40], after[:40], "the picture's upper edge has nothing to do with it")


def test_the_axis_of_a_poke_appears_where_it_enters_and_goes_when_the_tool_lifts(view):
    session = snapshot(1, {})
    view.show_state(tick_of(session, live(), Method.FREE, None))
    idle = pixels(view)
    assert view.show_state(tick_of(session, live((0.0, 0.0, 0.1), (2.0, 0.0, -8.0)), Method.FREE, None))
    pressing = pixels(view)
    stage = renderer_of(view)
    entry = np.array([0.1 * 2 / 8, 0.0, 0.0])
    np.testing.assert_allclose(points_of(stage.layers[3].contact)[0], entry, atol=1e-6)
    x, y, _ = project(stage.renderer, entry[None])[0]
    dot = around(pressing, (x, view.height() - y), 3)
    assert dot.min() > 180, "the contact is a dot in the ink of the dark theme"
    assert around(idle, (x, view.height() - y), 3).max() < 180
    ink = (np.abs(pressing.astype(int) - DARK.ink).max(axis=-1) < 12).sum()
    assert ink - (np.abs(idle.astype(int) - DARK.ink).max(axis=-1) < 12).sum() > 150
    assert view.show_state(tick_of(session, live(), Method.FREE, None))
    np.testing.assert_array_equal(pixels(view), idle)


def test_the_other_method_shows_its_own_estimates(view):
    free = {3: estimate(3, (-0.018, 0.005, 0.01))}
    surface = {3: estimate(3, (-0.010, 0.015, 0.0), Method.SURFACE), 15: estimate(15, (0.02, 0.01, 0.0), Method.SURFACE)}
    session = snapshot(1, free, surface)
    view.show_state(tick_of(session))
    first, place = pixels(view), screen_place(view, 3)
    assert screen_place(view, 15) is None
    assert view.show_state(tick_of(session, None, Method.SURFACE, None))
    second = pixels(view)
    assert screen_place(view, 3) != place
    for channel, row in ((3, 0), (15, 1)):
        ball = around(second, screen_place(view, channel), 2)
        assert np.abs(ball - MODULE_RGB[row].astype(int)).max() < 70
    assert (first != second).any(axis=-1).sum() > 100
    view.set_difference(True)
    assert (pixels(view) != second).any(axis=-1).sum() > 30, "a line leads to the other method's estimate"
    view.set_difference(False)
    np.testing.assert_array_equal(pixels(view), second)


@pytest.mark.parametrize("shown", [Method.FREE, Method.MODULES])
def test_without_a_mesh_lines_lead_to_the_other_method_that_there_is(qtbot, shown):
    view = make_view(qtbot, surface=False)
    session = snapshot(1, {3: estimate(3, (-0.018, 0.005, 0.0))}, {3: estimate(3, (-0.004, 0.015, 0.0))})
    free, other = (session.estimates[method] for method in (Method.FREE, Method.SURFACE))
    view.show_state(tick_of(replace(session, estimates={Method.FREE: free, Method.MODULES: other}), None, shown, None))
    before = pixels(view)
    view.set_difference(True)
    assert (pixels(view) != before).any(axis=-1).sum() > 30


def test_a_change_makes_one_picture_and_a_hidden_view_none(view):
    session, drawn = snapshot(1, {3: estimate(3, (0.0, 0.0, 0.0))}), Drawn(view)
    view.show_state(tick_of(session, live(), Method.FREE, None))
    settle()
    for pressing, pictures in ((False, 1), (False, 1), (True, 2), (True, 2)):
        moment = live((0.0, 0.0, 0.1)) if pressing else live()
        assert view.show_state(tick_of(session, moment, Method.FREE, None)) is (pictures > drawn.count)
        settle()
        assert drawn.count == pictures
    for generation in range(2, 12):
        view.show_state(tick_of(snapshot(generation, {3: estimate(3, (0.001 * generation, 0.0, 0.0))}), None, Method.FREE, 3))
    settle()
    assert drawn.count == 3, "many changes in one tick make one picture"
    view.hide()
    for generation in range(12, 16):
        assert not view.show_state(tick_of(snapshot(generation, {3: estimate(3, (0.0, 0.0, 0.0))})))
        settle()
    assert drawn.count == 3
    view.show()
    settle()
    assert drawn.count == 4
    assert screen_place(view, 3) is not None


def test_a_click_on_a_ball_names_its_channel(view, qtbot):
    known = {c: estimate(c, (*PLAN.places[c], 0.0005)) for c in range(24)}
    view.show_state(tick_of(snapshot(1, known)))
    settle()
    for channel in (3, 8, 15, 20):
        x, y = screen_place(view, channel)
        with qtbot.waitSignal(view.taxel_picked, timeout=1000) as picked:
            qtbot.mouseClick(canvas_of(view), Qt.MouseButton.LeftButton, pos=QPoint(round(x), round(y)))
        assert picked.args == [channel]


def test_neither_the_background_nor_a_drag_nor_the_far_side_picks(view, qtbot):
    view.show_state(tick_of(snapshot(1, {3: estimate(3, (-0.018, 0.0, 0.001), sd=1e-5)})))
    view.hide_layers(frozenset({"uncertainty"}))
    settle()
    x, y = (round(v) for v in screen_place(view, 3))
    canvas = canvas_of(view)
    with qtbot.assertNotEmitted(view.taxel_picked):
        qtbot.mouseClick(canvas, Qt.MouseButton.LeftButton, pos=QPoint(2, 2))
        qtbot.mousePress(canvas, Qt.MouseButton.LeftButton, pos=QPoint(x, y))
        qtbot.mouseMove(canvas, QPoint(x + 30, y))
        qtbot.mouseRelease(canvas, Qt.MouseButton.LeftButton, pos=QPoint(x + 30, y))
    view.reset_camera()
    turn(view, 180.0, 0.0)
    behind = pixels(view)
    x, y = (round(v) for v in screen_place(view, 3))
    assert np.ptp(around(behind, (x, y), 3), axis=-1).max() < 30, "it does not show through the part"
    with qtbot.assertNotEmitted(view.taxel_picked):
        qtbot.mouseClick(canvas, Qt.MouseButton.LeftButton, pos=QPoint(x, y))


def test_the_mouse_turns_shifts_and_comes_nearer_and_the_camera_comes_back(view):
    def place():
        active = renderer_of(view).renderer.GetActiveCamera()
        return np.array([active.GetPosition(), active.GetFocalPoint()])

    canvas, start, first = canvas_of(view), place(), pixels(view)
    drag(canvas, Qt.MouseButton.LeftButton)
    turned = place()
    np.testing.assert_allclose(turned[1], start[1], atol=1e-12)
    assert np.linalg.norm(turned[0] - turned[1]) == pytest.approx(np.linalg.norm(start[0] - start[1]))
    assert np.linalg.norm(turned[0] - start[0]) > 0.02
    assert (pixels(view) != first).any(axis=-1).mean() > 0.1
    drag(canvas, Qt.MouseButton.MiddleButton)
    np.testing.assert_allclose((place() - turned)[0], (place() - turned)[1], atol=1e-12)
    before = np.linalg.norm(np.diff(place(), axis=0))
    wheel(canvas, 240)
    assert np.linalg.norm(np.diff(place(), axis=0)) == pytest.approx(before / 1.15**2)
    view.reset_camera()
    np.testing.assert_allclose(place(), start, atol=1e-9)
    np.testing.assert_array_equal(pixels(view), first)


def test_keys_pass_the_view_by(view, qtbot, monkeypatch):
    heard = []
    monkeypatch.setattr(QMainWindow, "keyPressEvent", lambda _, event: heard.append(event.text()), raising=False)
    picture = pixels(view)
    qtbot.keyClicks(canvas_of(view), "wesq")
    np.testing.assert_array_equal(pixels(view), picture)
    assert canvas_of(view).focusPolicy() == Qt.FocusPolicy.NoFocus


def test_only_the_worst_and_the_selected_have_an_ellipsoid(view):
    spread = {c: estimate(c, (*PLAN.places[c], 0.0), sd=1e-4 * (1 + c)) for c in range(12)}
    layer = renderer_of(view).layers[4]
    session = snapshot(1, spread)
    assert layer.rows(tick_of(session)) == [11]
    assert layer.rows(tick_of(session, None, Method.FREE, 11)) == [11]
    assert layer.rows(tick_of(session, None, Method.FREE, 2)) == [11, 2]
    assert layer.rows(tick_of(session, None, Method.FREE, 20)) == [11]
    view.show_state(tick_of(session))
    first = pixels(view)
    view.show_state(
        tick_of(snapshot(2, {**spread, 11: estimate(11, (*PLAN.places[11], 0.0), sd=3e-3)}), None, Method.FREE, None)
    )
    assert (pixels(view) != first).any(axis=-1).sum() > 100


def test_what_has_no_position_gets_a_mark_at_its_planned_place_and_never_a_ball(view):
    view.show_state(tick_of(snapshot(1, {})))
    nothing = pixels(view)
    blind = Estimate(4, Method.FREE, State.BLIND, 1, worst_direction=np.array([0.0, 0.0, 1.0]))
    dead = Estimate(16, Method.FREE, State.DEAD, 0)
    assert view.show_state(tick_of(snapshot(2, {4: blind, 16: dead})))
    marked = pixels(view)
    assert len(renderer_of(view).estimates.shown) == 0
    for channel in (4, 16):
        x, y, _ = project(renderer_of(view).renderer, np.array([[*PLAN.places[channel], 0.0]]))[0]
        place = x, view.height() - y
        changed = np.abs(around(marked, place, 12) - around(nothing, place, 12)).max(axis=-1) > 20
        assert changed.sum() > 15
    assert np.isfinite(points_of(renderer_of(view).estimates.marks)).all()


def test_a_line_joins_the_selected_taxel_to_its_second_position_or_shows_where_an_undetermined_one_may_be(view):
    layer, direction, point = renderer_of(view).estimates, np.array([0.0, 0.6, 0.8]), np.array([0.01, 0.0, 0.0])
    sure = estimate(3, (0.0, 0.0, 0.0))
    rival = replace(sure, rival=Rival(np.array([0.034, 0.0, 0.0]), 1, 3.2))
    blind = Estimate(3, Method.FREE, State.BLIND, 2, worst_direction=direction, line_point=point)
    half = UNKNOWN_DEPTH_HALF_LENGTH_M * direction
    shown = point + (np.array([*PLAN.places[3], 0.0]) - point) @ direction * direction
    for generation, (known, ends) in enumerate(
        ((sure, None), (rival, [(0, 0, 0), (0.034, 0, 0)]), (blind, [shown - half, shown + half]))
    ):
        for selected in (3, 4, None):
            view.show_state(tick_of(snapshot(generation, {3: known}), None, Method.FREE, selected))
            drawn = points_of(layer.alternative).reshape(-1, 2, 3)
            assert (len(drawn) > 0) is (selected == 3 and ends is not None)
            if len(drawn):
                np.testing.assert_allclose(drawn[0], ends, atol=1e-9)


def test_a_selected_taxel_shows_its_newest_thirty_axes(view):
    pokes = [contact(n, 3 if n % 2 else 9, (*PLAN.places[3], 0.0), (0.1 * n, 0.0, -8.0)) for n in range(1, 101)]
    session = snapshot(1, {3: estimate(3, (*PLAN.places[3], 0.0))}, pokes=pokes)
    axes = renderer_of(view).layers[3]
    view.show_state(tick_of(session))
    assert len(points_of(axes.past)) // 2 == 0, "nothing is selected"
    view.show_state(tick_of(session, None, Method.FREE, 3))
    assert len(points_of(axes.past)) // 2 == MAX_DRAWN_FORCE_AXES
    ends = points_of(axes.past).reshape(-1, 2, 3).astype(float)
    through = ends[:, 1] - ends[:, 0]
    to_taxel = np.array([*PLAN.places[3], 0.0]) - ends[:, 0]
    miss = np.linalg.norm(np.cross(through, to_taxel), axis=1) / np.linalg.norm(through, axis=1)
    np.testing.assert_allclose(miss, 0.0, atol=1e-6)


# Axes of taxels are of skins of three axes alone: `test_taxel_axes.py`.
@pytest.mark.parametrize("name", [name for name in LAYER_NAMES if name != "turns"])
def test_a_layer_that_is_switched_off_is_gone_and_comes_back_as_it_was(view, name):
    known = {c: estimate(c, (*PLAN.places[c], 0.0), sd=3e-3) for c in range(12)}
    poked = snapshot(1, known, pokes=[contact(1, 3, (*PLAN.places[3], 0.0))])
    session = decided(poked, landmarks=(Landmark("screw", np.array([0.0, -0.03, 0.0]), None),))
    up = np.array([0.0, 0.0, 1.0])
    target = Target(None, np.array([0.0, 0.02, 0.0]), up, -up, 0.0, np.inf, 0.0)
    view.set_turning(False)
    view.show_state(tick_of(session, live((0.0, 0.0, 0.1)), Method.FREE, 3, target, 0.2))
    every = pixels(view)
    view.hide_layers(frozenset((name,)))
    without = pixels(view)
    assert (without != every).any(axis=-1).sum() > 50
    if name == "estimates":
        x, y = screen_place(view, 5)
        assert renderer_of(view).pick(x, view.height() - y) is None, "what is not seen is not meant"
    if name == "axes":
        drawn = Drawn(view)
        assert not view.show_state(tick_of(session, live(), Method.FREE, 3, target, 0.2))
        settle()
        assert drawn.count == 0, "a poke in progress asks for no picture"
        view.show_state(tick_of(session, live((0.0, 0.0, 0.1)), Method.FREE, 3, target, 0.2))
    view.hide_layers(frozenset())
    np.testing.assert_array_equal(pixels(view), every)


def test_the_picture_follows_theme_and_size_and_can_be_saved(view, tmp_path: Path):
    view.show_state(tick_of(snapshot(1, {3: estimate(3, (0.0, 0.0, 0.0))})))
    for dark, colours in ((True, DARK), (False, LIGHT), (True, DARK)):
        view.set_dark(dark)
        assert tuple(pixels(view)[2, 2]) == colours.background
    view.window().resize(800, 500)
    settle()
    shown = pixels(view)
    assert shown.shape == (500, 800, 3)
    for corner in ((2, 2), (2, 797), (497, 2), (497, 797)):
        assert tuple(shown[corner]) == DARK.background
    view.screenshot(tmp_path / "view.png")
    image = QImage(str(tmp_path / "view.png"))
    assert (image.width(), image.height()) == (800, 500)
    assert image.pixelColor(2, 2).getRgb()[:3] == tuple(shown[2, 2])
    with pytest.raises(InputError, match="cannot be written"):
        view.screenshot(tmp_path / "no" / "view.png")


@pytest.mark.parametrize("canvas", list(Canvas))
def test_sizes_follow_the_pixel_ratio_of_the_screen_and_letters_also_the_text_size(qtbot, monkeypatch, canvas):
    view = make_view(qtbot, canvas)
    known = {c: estimate(c, (*PLAN.places[c], 0.0)) for c in range(24)}
    view.show_state(tick_of(snapshot(1, known), None, Method.FREE, 3))
    view.hide_layers(frozenset(("surface",)))

    def spots() -> tuple[float, float]:
        """Shares of the picture in a module's hue, and in the ink of rings, hints and words."""
        renderer_of(view)._before_picture()
        canvas_of(view).update()
        image = canvas_of(view).grabFramebuffer().convertToFormat(QImage.Format.Format_RGB888)
        rows = np.frombuffer(image.constBits(), np.uint8).reshape(image.height(), image.bytesPerLine())
        seen = rows[:, : 3 * image.width()].reshape(image.height(), image.width(), 3).astype(int)
        return tuple((np.abs(seen - colour).max(axis=2) < 30).mean() for colour in (MODULE_RGB[0], DARK.ink))

    hue, ink = spots()
    if canvas is Canvas.RASTER:
        monkeypatch.setattr(type(canvas_of(view)), "devicePixelRatioF", lambda _: 2.0)
        assert spots() == pytest.approx((hue, ink), rel=0.15)
        monkeypatch.undo()
    monkeypatch.setattr("app.scene3d.canvas.text_scale", lambda: 2.0)
    assert spots()[1] > 1.2 * ink


def test_estimates_stay_in_the_picture_where_nothing_else_says_where_the_part_is(qtbot):
    view = make_view(qtbot, surface=False, plan=False)
    view.show_state(
        tick_of(snapshot(1, {3: estimate(3, (0.5, 0.4, 0.3)), 4: estimate(4, (0.52, 0.4, 0.3))}), None, Method.FREE, None)
    )
    settle()
    for channel in (3, 4):
        x, y = screen_place(view, channel)
        assert 0 < x < view.width()
        assert 0 < y < view.height()
    assert view.show_state(tick_of(snapshot(2, {}), live((0.5, 0.4, 0.3)), Method.FREE, 7))


def test_closing_leaves_no_timer_thread_or_stage_and_may_be_repeated(view, qtbot):
    view.show_state(tick_of(snapshot(1, {3: estimate(3, (0.0, 0.0, 0.0))}), live((0.0, 0.0, 0.1)), Method.FREE, 3))
    settle()
    stage = weakref.ref(renderer_of(view))
    view.close_view()
    view.close_view()
    QApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)
    gc.collect()
    assert stage() is None
    assert not [timer for timer in view.findChildren(QTimer) if timer.isActive()]
    assert not [thread for thread in threading.enumerate() if thread.name == "skincal-scene3d"]
    assert view.list_layers() == ()
    assert not view.show_state(tick_of(snapshot(2, {})))
    view.reset_camera()
    view.set_dark(False)
    with qtbot.waitSignal(view.ready, timeout=60_000):
        view.build_scene(StaticScene(Part(scene(PLAN), None, laid(PLAN), np.arange(24), ())))
    assert view.list_layers() == EVERY[1:], "it may begin again, with another scene"


def test_closing_while_it_loads_waits_for_the_worker_and_draws_nothing(qtbot):
    view = View3D(canvas=Canvas.RASTER)
    qtbot.addWidget(view)
    with qtbot.waitExposed(view):
        view.show()
    with qtbot.assertNotEmitted(view.ready):
        view.build_scene(StaticScene(Part(scene(PLAN), box(), laid(PLAN), np.arange(24), ())))
        assert not view.show_state(tick_of(snapshot(1, {})))
        view.close_view()
        settle()
    assert view.list_layers() == ()
    assert not [thread for thread in threading.enumerate() if thread.name == "skincal-scene3d"]


def test_a_view_that_is_deleted_while_it_loads_does_nothing_more(qtbot):
    """An exception of an event fails the test."""
    view, settled = View3D(canvas=Canvas.RASTER), []
    view.settled.connect(lambda: settled.append(1))
    view.build_scene(StaticScene(Part(scene(PLAN), box(), laid(PLAN), np.arange(24), ())))
    threads = view._threads
    shiboken6.delete(view)
    threads.wait()
    qtbot.wait(50)
    assert not settled


def test_where_nothing_can_draw_the_view_says_so_and_the_window_lives_on(qtbot, monkeypatch):
    def refuse(_probe):
        raise InputError("No picture can be drawn: install libegl1.")

    monkeypatch.setattr(canvas, "choose_offscreen", refuse)
    view = View3D(canvas=Canvas.RASTER)
    qtbot.addWidget(view)
    with qtbot.waitExposed(view):
        view.show()
    view.build_scene(StaticScene(Part(scene(PLAN), box(), laid(PLAN), np.arange(24), ())))
    qtbot.waitUntil(lambda: "install libegl1" in view.findChild(QLabel).text(), timeout=30_000)
    assert not view.show_state(tick_of(snapshot(1, {})))
    with pytest.raises(InputError, match="no picture yet"):
        view.screenshot(Path("x.png"))


def test_on_a_graphics_card_the_interactor_shows_the_same_layers(qtbot):
    view = make_view(qtbot, Canvas.OPENGL)
    assert view.list_layers() == EVERY
    assert not [timer for timer in view.findChildren(QTimer) if timer.isActive()]
    view.show_state(tick_of(snapshot(1, {15: estimate(15, (0.018, 0.0, 0.002))})))
    settle()
    drawn = Drawn(view)
    assert not view.show_state(tick_of(snapshot(1, {})))
    settle()
    assert drawn.count == 0
    assert view.show_state(tick_of(snapshot(2, {15: estimate(15, (0.018, 0.003, 0.002))})))
    settle()
    assert drawn.count == 1
    x, y = screen_place(view, 15)
    assert np.abs(around(pixels(view), (x, y), 2) - MODULE_RGB[1].astype(int)).max() < 70
    with qtbot.waitSignal(view.taxel_picked, timeout=1000) as picked:
        qtbot.mouseClick(canvas_of(view), Qt.MouseButton.LeftButton, pos=QPoint(round(x), round(y)))
    assert picked.args == [15]
    view.close_view()
    view.close_view()


@pytest.mark.parametrize("size", [(900, 300), (300, 700)])
def test_the_part_fills_a_window_of_another_shape_until_a_hand_moves_it(view, size):
    def ends():
        at = project(renderer_of(view).renderer, box().vertices)[:, :2] / np.array(renderer_of(view).window.GetSize())
        return at.min(axis=0), at.max(axis=0)

    view.window().resize(*size)
    settle()
    low, high = ends()
    assert (high - low).max() == pytest.approx(1 / 1.08, abs=0.01)
    np.testing.assert_allclose(low + high, 1.0, atol=0.01)
    wheel(canvas_of(view), 240)
    settle()
    zoomed = pose_of(renderer_of(view).renderer.GetActiveCamera())
    view.window().resize(500, 500)
    settle()
    np.testing.assert_array_equal(pose_of(renderer_of(view).renderer.GetActiveCamera()).position, zoomed.position)

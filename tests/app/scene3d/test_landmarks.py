"""Landmarks in the 3D view: how they look, and the point of the part that a click means."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from PySide6.QtCore import QEvent, QPoint, QPointF, Qt
from PySide6.QtGui import QMouseEvent
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication

from app.scene3d.canvas import Canvas
from app.scene3d.landmarks import MAX_LANDMARKS_WITH_NAMES, normals_of, poked_here
from skincal.guide.guidance import Target
from skincal.model.scene import Landmark
from skincal.session.snapshot import PokeRecord
from skincal.taxels.result import Method
from tests.app.scene3d_support import box, contact, decided, live, project, snapshot, tick_of
from tests.app.view3d_on_screen import Drawn, around, canvas_of, make_view, pixels, renderer_of, settle, turn
from tests.app.window_support import luminance

UP = np.array([0.0, 0.0, 1.0])
HEAD = Landmark("head", np.array([0.020, -0.022, 0.0]), UP)
CORNER = Landmark("corner", np.array([-0.025, 0.020, 0.0]), None)


@pytest.fixture
def view(qtbot):
    return make_view(qtbot)


def session(generation, landmarks, at=None, poses=(), excluded=()):
    """A session with landmarks; poke number n was made in the n-th of `poses`."""
    pokes = [replace(contact(n, 3, (0.0, 0.0, 0.0)), pose=name) for n, name in enumerate(poses, 1)]
    records = tuple(PokeRecord(poke, poke.poke in excluded) for poke in pokes)
    return decided(replace(snapshot(generation, {}), at_landmarks=at or {}, pokes=records), landmarks=landmarks)


def show(view, at, target=None):
    return view.show_state(tick_of(at, live(), Method.FREE, None, target))


def seen(view, place):
    """Where a point appears in the widget."""
    x, y, _ = project(renderer_of(view).renderer, np.atleast_2d(place))[0]
    return x, view.height() - y


def changed(one, other, place, reach=7):
    return int((np.abs(around(one, place, reach) - around(other, place, reach)).max(axis=-1) > 25).sum())


@pytest.mark.parametrize("dark", [True, False])
def test_a_landmark_appears_on_the_part_and_looks_otherwise_once_it_is_poked(view, dark):
    view.set_dark(dark)
    show(view, session(1, ()))
    bare = pixels(view)
    assert show(view, session(2, (HEAD, CORNER)))
    there = pixels(view)
    for landmark in (HEAD, CORNER):
        assert changed(bare, there, seen(view, landmark.place)) > 25
    assert show(view, session(3, (HEAD, CORNER), {1: "head"}, ("low",)))
    poked = pixels(view)
    assert changed(there, poked, seen(view, HEAD.place)) > 10
    assert changed(there, poked, seen(view, CORNER.place)) == 0
    # Told by shape: the cross is gone from the middle, which looks as it did without a landmark.
    assert changed(bare, there, seen(view, HEAD.place), 2) > 4
    assert changed(bare, poked, seen(view, HEAD.place), 2) == 0
    assert show(view, session(4, ()))
    np.testing.assert_array_equal(pixels(view), bare)


def test_poked_is_said_of_the_pose_in_which_the_arm_stands_and_of_pokes_that_count():
    three = {1: "head", 2: "corner", 3: "gone"}
    at = session(1, (HEAD, CORNER), three, ("low", "high", "low"))
    assert poked_here(at, "low") == {"head", "gone"}
    assert poked_here(at, "high") == {"corner"}
    assert poked_here(session(1, (HEAD,), three, ("low", "low", "low"), excluded=(1,)), "low") == {"corner", "gone"}
    assert poked_here(session(1, (HEAD,), {9: "head"}, ("low",)), "low") == frozenset()


def test_nothing_is_drawn_where_nothing_changed_or_there_is_none(view):
    show(view, session(1, ()))
    settle()
    layer, drawn = renderer_of(view).landmarks, Drawn(view)
    assert not layer.marks.actor.visibility
    assert not layer.labels
    assert not layer.show(tick_of(session(2, ()), None, Method.FREE, None))
    show(view, session(3, (HEAD,)))
    settle()
    count = drawn.count
    assert not show(view, session(3, (HEAD,)))
    # Streamed joints make a new snapshot of the same landmarks.
    assert not layer.show(tick_of(session(4, (HEAD,)), None, Method.FREE, None)), "another tuple with the same landmark"
    settle()
    assert drawn.count == count


def test_few_landmarks_have_names_and_many_have_none(view):
    show(view, session(1, (HEAD, CORNER)))
    settle()
    assert {"head", "corner"} < set(renderer_of(view).labels.shown)
    with_names = pixels(view)
    many = tuple(
        Landmark(f"p{n}", HEAD.place + np.array([0.0, 0.003 * n, 0.0]), UP) for n in range(MAX_LANDMARKS_WITH_NAMES + 1)
    )
    show(view, session(2, many))
    settle()
    assert not {"head", "p0"} & set(renderer_of(view).labels.shown)
    show(view, session(3, many[:MAX_LANDMARKS_WITH_NAMES]))
    settle()
    assert {f"p{n}" for n in range(MAX_LANDMARKS_WITH_NAMES)} < set(renderer_of(view).labels.shown)
    show(view, session(4, (HEAD, CORNER)))
    np.testing.assert_array_equal(pixels(view), with_names)


@pytest.mark.parametrize("dark", [True, False])
def test_names_are_read_upon_the_part_and_beside_it_poked_or_not(view, dark):
    view.set_dark(dark)
    aside = Landmark("outside", np.array([0.055, 0.0, 0.0]), UP)
    show(view, session(1, (HEAD, CORNER, aside), {1: "head"}, ("low",)))
    picture = pixels(view)
    for middle in label_middles(view, ("head", "corner", "outside")):
        words = around(picture, middle, 6).reshape(-1, 3)
        dim, bright = np.sort(luminance(words))[[3, -4]]
        assert (bright + 0.05) / (dim + 0.05) >= 4.5


def label_middles(view, texts) -> np.ndarray:
    """(n, 2) pixels of the widget: the middles of labels, as they were placed."""
    labels = renderer_of(view).labels
    corners = project(renderer_of(view).renderer, labels.mesh.points)[[labels.shown.index(text) for text in texts], :2]
    half = np.array([(7.0 * len(text) / 2, 9.0) for text in texts])
    return (corners + half) * [1, -1] + [0, view.height()]


@pytest.mark.parametrize("push", [(0.0, 0.0, -1.0), (-0.6, 0.0, -0.8), (0.6, 0.0, -0.8), (0.0, 0.6, -0.8)])
def test_names_keep_clear_of_ring_and_arrow_and_the_target_of_its_own(view, push):
    renderer_of(view).auto_camera.wanted = False
    close = replace(HEAD, name="close", place=HEAD.place + np.array([0.004, 0.0, 0.0]))
    for landmark, channel in (("head", None), ("", 3)):
        wanted = Target(channel, HEAD.place, UP, np.array(push), 0.0, np.inf, 0.0, landmark=landmark)
        show(view, session(1, (HEAD, CORNER, close)), wanted)
        settle()
        texts = ["head", "corner", "close", *(["3"] if channel is not None else [])]
        assert ("3" in renderer_of(view).labels.shown) is (channel is not None)
        at = label_middles(view, texts)
        covered = np.array([seen(view, place) for place in renderer_of(view).target.obstacles()])
        assert np.hypot(*(at[:, None] - covered).T).min() > 8.0
        apart = np.abs(at[:, None] - at) + 100.0 * np.eye(len(at))[..., None]
        assert (apart.max(axis=-1) > 12.0).all(), "nor do they stand on each other"


def test_what_lies_behind_the_part_is_left_out_until_the_part_is_turned(view):
    below = Landmark("below", np.array([0.0, 0.0, -0.02]), -UP)
    show(view, session(1, ()))
    bare = pixels(view)
    show(view, session(2, (below,)))
    np.testing.assert_array_equal(pixels(view), bare)
    turn(view, 180.0, 0.0)
    settle()
    assert renderer_of(view).landmarks.marks.actor.visibility
    assert "below" in renderer_of(view).labels.shown


def test_a_landmark_without_a_normal_lies_on_the_face_that_is_nearest():
    wall = Landmark("wall", np.array([0.041, 0.0, -0.01]), None)
    np.testing.assert_allclose(normals_of((HEAD, wall, CORNER), box()), [UP, [1.0, 0.0, 0.0], UP], atol=1e-12)
    np.testing.assert_allclose(normals_of((wall,), None), [UP])


@pytest.mark.parametrize("surface", [True, False])
def test_a_landmark_that_is_asked_for_has_the_ring_in_any_scene(qtbot, surface):
    view = make_view(qtbot, surface=surface, plan=False)
    show(view, session(1, (HEAD, CORNER)))
    before = pixels(view)
    wanted = Target(None, HEAD.place + 0.002 * UP, UP, -UP, 0.0, np.inf, 0.0, landmark="head")
    assert show(view, session(1, (HEAD, CORNER)), wanted)
    renderer_of(view).auto_camera.wanted = False
    assert changed(before, pixels(view), seen(view, wanted.place), 30) > 60
    np.testing.assert_array_equal(renderer_of(view).target.at, wanted.place)
    if not surface:
        far = tuple(replace(landmark, place=landmark.place + np.array([0.5, 0.4, 0.3])) for landmark in (HEAD, CORNER))
        show(view, session(2, far))
        settle()
        for landmark in far:
            x, y = seen(view, landmark.place)
            assert 0 < x < view.width()
            assert 0 < y < view.height()


# The point of the part that a click means


def click(view, x, y):
    QTest.mouseClick(canvas_of(view), Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier, QPoint(x, y))


@pytest.mark.parametrize("canvas", list(Canvas))
def test_the_picked_point_lies_on_the_part_within_a_pixel_of_what_is_clicked(qtbot, canvas):
    view = make_view(qtbot, canvas)
    picked = []
    view.surface_picked.connect(picked.append)
    for known in ((0.011, -0.007, 0.0), (-0.033, 0.021, 0.0), (0.031, 0.036, 0.0)):
        x, y = seen(view, known)
        view.set_picking(True)
        click(view, int(x), int(y))
        place = picked.pop()
        assert abs(place[2]) < 1e-9, "on the mesh"
        assert np.abs(np.array(seen(view, place)) - (int(x) + 0.5, int(y) + 0.5)).max() < 1e-6
        aside = np.linalg.norm(place - known)
        pixel = np.linalg.norm(np.array(known) - renderer_of(view).pick_surface(x + 1, view.height() - y))
        assert aside <= 1.5 * pixel
        assert pixel < 0.5e-3
        assert not view.picking, "one click ends it"
        turn(view, -17.0, 9.0)


def test_while_a_point_is_wanted_the_pointer_is_a_cross_and_a_click_means_no_taxel(view, qtbot):
    show(view, snapshot(1, {}))
    assert view.can_pick
    view.set_picking(True)
    assert canvas_of(view).cursor().shape() == Qt.CursorShape.CrossCursor
    with qtbot.assertNotEmitted(view.surface_picked), qtbot.assertNotEmitted(view.taxel_picked):
        click(view, 3, 3)
    assert view.picking, "a click beside the part says nothing"
    eye = view.eye()
    with qtbot.assertNotEmitted(view.surface_picked):
        QTest.mousePress(canvas_of(view), Qt.MouseButton.LeftButton, pos=QPoint(320, 240))
        for x in (330, 350, 380):
            drag(canvas_of(view), x)
        QTest.mouseRelease(canvas_of(view), Qt.MouseButton.LeftButton, pos=QPoint(380, 240))
    assert not np.allclose(view.eye().axes, eye.axes), "a drag turns the part"
    assert view.picking
    with qtbot.waitSignal(view.surface_picked):
        click(view, 320, 240)
    assert canvas_of(view).cursor().shape() == Qt.CursorShape.ArrowCursor
    with qtbot.assertNotEmitted(view.surface_picked):
        click(view, 320, 240)


def drag(canvas, x):
    left, none = Qt.MouseButton.LeftButton, Qt.MouseButton.NoButton
    at = QPointF(x, 240)
    QApplication.sendEvent(canvas, QMouseEvent(QEvent.Type.MouseMove, at, at, none, left, Qt.KeyboardModifier.NoModifier))


def test_the_camera_waits_while_a_point_is_wanted(view, qtbot):
    behind = Target(None, np.array([0.0, 0.0, -0.02]), -UP, UP, 0.0, np.inf, 0.0, landmark="below")
    view.set_picking(True)
    eye = view.eye()
    for _ in range(5):
        show(view, session(1, ()), behind)
    assert np.allclose(view.eye().axes, eye.axes)
    renderer_of(view).auto_camera.note_manual_move(-1e9)
    view.set_picking(False)

    def turns() -> bool:
        show(view, session(1, ()), behind)
        return not np.allclose(view.eye().axes, eye.axes)

    qtbot.waitUntil(turns, timeout=5000)


def test_a_scene_without_a_part_to_click_on_cannot_be_picked(qtbot):
    view = make_view(qtbot, surface=False)
    assert not view.can_pick
    assert renderer_of(view).pick_surface(320.0, 240.0) is None

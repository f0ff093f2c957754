"""A landmark is added: by the command, a click on the part or its coordinates, and a name."""

from __future__ import annotations

import numpy as np
import pytest
from PySide6.QtCore import QLocale, QPoint, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QDialogButtonBox, QWidget

from app.dialogs.landmark_dialog import CLICK_REQUEST, LandmarkDialog, LandmarkPicking, free_name, name_problem
from app.session.opening import OpenRequest
from app.text.message import Message
from skincal.mesh.search import nearest_points
from skincal.model.actions import AddLandmark
from tests.app.view3d_on_screen import canvas_of, make_view, points_of, renderer_of

Key = Qt.Key
PLACE = np.array([0.01234, -0.0456, 0.0])


def dialogs() -> list[LandmarkDialog]:
    return [w for w in QApplication.topLevelWidgets() if isinstance(w, LandmarkDialog) and w.isVisible()]


def the_dialog(bench) -> LandmarkDialog:
    bench.until(lambda: len(dialogs()) == 1, 5000)
    dialog = dialogs()[0]
    dialog.activateWindow()
    bench.until(lambda: dialog.isActiveWindow() and dialog.name.hasFocus(), 5000)
    return dialog


def click_part(view) -> None:
    QTest.mouseClick(canvas_of(view), Qt.MouseButton.LeftButton, pos=QPoint(view.width() // 2, view.height() // 2))


def test_a_point_is_clicked_or_typed_named_shown_and_taken_back(bench, recorded):
    bench.open(OpenRequest(session=recorded))
    bench.until_all_is_there()
    window, view = bench.window, bench.window.session_view.workspace.view
    before = bench.snapshot.decisions.landmarks
    shown = len(points_of(renderer_of(view).landmarks.marks)) // 2
    bench.key(Key.Key_K)
    assert view.picking
    assert window.messages.isVisible()
    assert CLICK_REQUEST.text in window.messages.text.text()
    bench.qtbot.wait(100)
    click_part(view)
    assert not window.messages.isVisible()
    dialog = the_dialog(bench)
    surface = window.session_view.workspace.part.surface
    there = dialog.position()
    assert np.linalg.norm(nearest_points(surface, there[None])[0][0] - there) < 1e-5
    assert dialog.name.text() == "landmark 1"
    QTest.keyClicks(dialog.name, "screw 4")
    QTest.keyClick(dialog.name, Key.Key_Return)
    bench.until(lambda: len(bench.snapshot.decisions.landmarks) == len(before) + 1, 5000)
    added = bench.snapshot.decisions.landmarks[-1]
    assert added.name == "screw 4"
    np.testing.assert_allclose(added.place, there, atol=1e-12)
    bench.until(lambda: not dialogs(), 5000)
    bench.qtbot.wait(50)
    assert len(points_of(renderer_of(view).landmarks.marks)) // 2 == shown + 6, "a diamond with a cross"
    assert bench.snapshot.can_undo == "landmark screw 4"
    bench.key(Key.Key_Backspace)
    bench.until(lambda: bench.snapshot.decisions.landmarks == before, 5000)
    bench.qtbot.wait(50)
    assert len(points_of(renderer_of(view).landmarks.marks)) // 2 == shown
    the_command_again_asks_for_coordinates(bench)
    escape_ends_the_wait(bench)
    bench.key(Key.Key_K)
    bench.open(OpenRequest(session=recorded))
    assert not window.messages.isVisible(), "another session waits for no click"
    assert not bench.window.session_view.picking.waiting


def the_command_again_asks_for_coordinates(bench):
    before = len(bench.snapshot.decisions.landmarks)
    bench.key(Key.Key_K)
    assert "K: type" in CLICK_REQUEST.text
    bench.key(Key.Key_K)
    dialog = the_dialog(bench)
    assert not bench.window.session_view.workspace.view.picking
    assert not bench.window.messages.isVisible()
    for box in dialog.coordinates:
        QTest.keyClick(QApplication.focusWidget(), Key.Key_Tab)
        assert box.hasFocus()
        QTest.keyClicks(QApplication.focusWidget(), "12.5")
    QTest.keyClick(dialog, Key.Key_Return)
    bench.until(lambda: len(bench.snapshot.decisions.landmarks) == before + 1, 5000)
    np.testing.assert_allclose(bench.snapshot.decisions.landmarks[-1].place, [0.0125] * 3, atol=1e-12)
    bench.until(lambda: not dialogs(), 5000)


def escape_ends_the_wait(bench):
    view, messages = bench.window.session_view.workspace.view, bench.window.messages
    bench.key(Key.Key_K)
    assert view.picking
    bench.key(Key.Key_Escape)
    assert not view.picking
    assert not messages.isVisible()
    click_part(view)
    assert not dialogs()
    bench.key(Key.Key_K)
    bench.window.tell(Message("The disk is full.", error=True))
    bench.key(Key.Key_Escape)
    assert not view.picking
    assert "The disk is full." in messages.text.text(), "what was said meanwhile stays"
    bench.key(Key.Key_Escape)
    assert not messages.isVisible()


# Where nothing can be clicked


class Acts(list):
    def __call__(self, action):
        self.append(action)
        return True


def test_coordinates_are_asked_for_at_once_where_there_is_no_surface(qtbot):
    view, acts, said = make_view(qtbot, surface=False), Acts(), []
    picking = LandmarkPicking(view, lambda: {"landmark 1"}, acts, "palm", view)
    picking.said.connect(said.append)
    picking.ask(view.window())
    assert not picking.waiting
    assert said == []
    (dialog,) = dialogs()
    assert dialog.name.text() == "landmark 2"
    assert dialog.position().tolist() == [0.0, 0.0, 0.0]
    for box_, typed in zip(dialog.coordinates, ("12.5", "-3", "0.25"), strict=True):
        box_.selectAll()
        QTest.keyClicks(box_, typed)
    QTest.keyClick(dialog.name, Key.Key_Return)
    assert len(acts) == 1
    assert isinstance(acts[0], AddLandmark)
    assert acts[0].name == "landmark 2"
    np.testing.assert_allclose((acts[0].x, acts[0].y, acts[0].z), (0.0125, -0.003, 0.00025), atol=1e-12)
    assert all(type(value) is float for value in (acts[0].x, acts[0].y, acts[0].z))


@pytest.fixture
def dialog(qtbot):
    window = QWidget()
    qtbot.addWidget(window)
    made = LandmarkDialog(PLACE, {"landmark 1", "head"}, "palm", window)
    with qtbot.waitExposed(made):
        made.show()
    yield made
    window.close()


def test_a_name_that_is_empty_or_taken_is_refused_with_the_reason(dialog, qtbot):
    ok = dialog.buttons.button(QDialogButtonBox.StandardButton.Ok)
    for name, said in ((" ", "has no name"), ("head", "'head' already")):
        dialog.name.setText(name)
        with qtbot.assertNotEmitted(dialog.given):
            QTest.mouseClick(ok, Qt.MouseButton.LeftButton)
        assert dialog.isVisible()
        assert said in dialog.objection.text()
    dialog.name.setText("  head 2 ")
    with qtbot.waitSignal(dialog.given) as given:
        QTest.mouseClick(ok, Qt.MouseButton.LeftButton)
    assert given.args[0] == "head 2"
    np.testing.assert_allclose(given.args[1], PLACE, atol=5.1e-6)


def test_the_place_is_shown_in_millimetres_and_can_be_changed(dialog):
    assert [field.text() for field in dialog.coordinates] == ["x  12.34 mm", "y  -45.60 mm", "z  0.00 mm"]
    assert all(field.locale() == QLocale.c() for field in dialog.coordinates)
    dialog.coordinates[2].setValue(1.5)
    np.testing.assert_allclose(dialog.position(), [0.01234, -0.0456, 0.0015], atol=1e-12)
    dialog.coordinates[2].setValue(1e9)
    assert dialog.position()[2] == pytest.approx(10.0), "no part reaches farther"


def test_the_names_that_are_proposed_and_refused():
    assert free_name(()) == "landmark 1"
    assert free_name({"landmark 1", "landmark 2", "x"}) == "landmark 3"
    assert name_problem("a", {"b"}) == ""
    assert name_problem("", ()) != ""

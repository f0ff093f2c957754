import os
import sys

import pytest
from PySide6.QtCore import Qt
from PySide6.QtGui import QColor, QImage, QPainter

from app.session.opening import server_command
from app.theme import MODULE_HUES
from tests.app.test_window_start import python
from tools import freeze
from tools.freeze import WindowProgress, left_out, shows_taxels


def picture():
    image = QImage(1280, 800, QImage.Format.Format_RGB32)
    image.fill(QColor("#b0b0b0"))
    return image


@pytest.mark.parametrize("hue", MODULE_HUES)
def test_a_ball_in_a_module_s_hue_is_a_taxel_and_its_outline_is_none(hue):
    image = picture()
    painter = QPainter(image)
    painter.setPen(QColor(hue))
    painter.drawEllipse(200, 200, 90, 90)
    assert not shows_taxels(image)
    painter.setBrush(QColor(hue))
    painter.setPen(Qt.PenStyle.NoPen)
    painter.drawEllipse(400, 300, 14, 14)
    painter.end()
    assert shows_taxels(image)


def test_a_ball_on_the_map_beside_the_3d_view_is_none():
    image = picture()
    painter = QPainter(image)
    painter.setBrush(QColor(MODULE_HUES[0]))
    painter.drawEllipse(1000, 100, 30, 30)
    painter.end()
    assert not shows_taxels(image)


def test_a_slow_window_has_time_while_its_session_grows_and_a_hung_one_has_not(tmp_path, monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(freeze.time, "monotonic", lambda: clock[0])
    progress, lines = WindowProgress(tmp_path, picture), tmp_path / "segment-0001.jsonl"
    for second in range(0, 3600, 60):
        clock[0] = float(second)
        lines.write_bytes(b'["00000000",1]\n' * (second + 1))
        assert not progress.update()
        assert not progress.is_stuck()
    clock[0] += freeze.WINDOW_HANGS_AFTER_S + 1.0
    progress.update()
    assert progress.is_stuck()
    lines.write_bytes(b'["00000000",1,"contact 1",{}]\n' * (freeze.MAX_POKES_WITHOUT_TAXEL + 1))
    progress.update()
    assert progress.pokes == freeze.MAX_POKES_WITHOUT_TAXEL + 1
    assert progress.is_stuck()


def test_a_frozen_program_is_its_own_child(monkeypatch):
    assert server_command(None)[1:4] == ("-P", "-m", "skincal.cli")
    monkeypatch.setattr(sys, "frozen", True, raising=False)
    command = server_command(None)
    assert command[:3] == (sys.executable, "simulate", "--serve")


CARD = """
import sys

# None there is a module that cannot be imported.
sys.modules.update(dict.fromkeys({left_out}))
from PySide6.QtWidgets import QApplication, QWidget
application = QApplication([])
from app.scene3d.canvas import Canvas, load, mount
from app.scene3d.scene_state import DARK, StaticScene
from skincal.model.scene import load_scene, resource
from skincal.part.part import Part
static = StaticScene(Part(load_scene(resource("scenes/flat-patch/scene.toml")), None, None, range(64), ()))
parent = QWidget()
parent.show()
canvas, renderer = mount(Canvas.OPENGL, load(Canvas.OPENGL, static, DARK, (300, 200), None), static, DARK, parent)
canvas.render()
renderer.close()
canvas.close()
"""


def test_the_canvas_of_a_graphics_card_needs_nothing_that_is_left_out():
    display = os.environ.get("DISPLAY")
    if not display:
        pytest.skip("there is no display here")
    done = python(CARD.format(left_out=set(left_out())), DISPLAY=display)
    assert done.returncode == 0, done.stderr

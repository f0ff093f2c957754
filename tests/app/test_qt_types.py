"""Threads import what names all of Qt's types after the window's thread has made them; imports read no sources for PySide6."""

import pytest

from tests.app.test_window_start import python

COUNT = """
import sys
from PySide6 import QtCore, QtGui, QtWidgets
from app.scene3d.canvas import Canvas, prepare_import

def look():
    unnamed = [name for module in (QtCore, QtGui, QtWidgets) for name in dir(module) if name not in vars(module)]
    print("types to make" if unnamed else "none", QtCore.QThread.currentThread() is application.thread())
    application.quit()

application = QtWidgets.QApplication([])
QtCore.QTimer.singleShot(0, lambda: prepare_import(Canvas({canvas!r}), application, look))
sys.exit(application.exec())
"""


@pytest.mark.parametrize(("canvas", "left"), [("opengl", "none"), ("raster", "types to make")])
def test_types_are_made_before_the_widgets_of_a_graphics_card_are_imported(canvas, left):
    done = python(COUNT.format(canvas=canvas), QT_QPA_PLATFORM="offscreen")
    assert done.stdout.splitlines() == [f"{left} True"], done.stderr
    assert done.returncode == 0, done.stderr


SOURCES = """
import linecache, sys
from PySide6 import QtCore
from app.qt_types import skip_feature_search

if {skips!r}:
    skip_feature_search()
import colorsys
print("read" if colorsys.__file__ in linecache.cache else "not read")
"""


@pytest.mark.parametrize(("skips", "seen"), [(True, "not read"), (False, "read")])
def test_sources_of_imported_modules_are_not_searched_for_features(skips, seen):
    # Once PySide6 reads no sources, the second case fails, and nothing has to be skipped.
    done = python(SOURCES.format(skips=skips))
    assert done.stdout.split("\n")[0] == seen, done.stderr

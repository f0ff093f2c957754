"""What PySide6 does when types are named and modules imported.

PySide6 makes a type when it is first named. pyqtgraph and pyvistaqt name all types at their import, which runs beside the
window. A type that the window uses while another thread makes it ends the program (docs/decisions/work-beside-the-window.md).
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator

from PySide6 import QtCore, QtGui, QtWidgets
from PySide6.QtCore import QObject, QTimer

FEATURE_SEARCH = "shibokensupport.feature"
"""PySide6's own module that looks for other names of Qt's functions (`__feature__`)."""
NAMING_STEP_S = 0.005
"""s of the window's thread at a time; all take about 0.1 s."""


def skip_feature_search() -> None:
    """Let PySide6 not read the source of each module that is imported from now on; does nothing where it has no such search.

    It looks there for `PySide6`, since a module may ask for other names of Qt's functions; the program does not. The sources
    of pyvista and numpy take 20 MB, and a tenth of the time of their import.
    """
    search = sys.modules.get(FEATURE_SEARCH)
    if hasattr(search, "_mod_uses_pyside"):
        search.__dict__["_mod_uses_pyside"] = lambda _: False


def name_types(owner: QObject, then: Callable[[], object]) -> None:
    """Name all of Qt's types a few at a time, then call `then`, both in the window's thread and only while `owner` exists."""
    _name_some(owner, then, _unnamed())


def _unnamed() -> Iterator[None]:
    """Name one type at each step."""
    for module in (QtCore, QtGui, QtWidgets):
        for name in dir(module):
            if name not in vars(module):
                getattr(module, name)
                yield


def _name_some(owner: QObject, then: Callable[[], object], unnamed: Iterator[None]) -> None:
    end_s = time.perf_counter() + NAMING_STEP_S
    for _ in unnamed:
        if time.perf_counter() > end_s:
            QTimer.singleShot(0, owner, lambda: _name_some(owner, then, unnamed))
            return
    then()

"""The menu of recent sessions."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtCore import QSettings, Signal
from PySide6.QtWidgets import QMenu, QWidget

from app.panels.widgets import escape_tooltip
from skincal.model.errors import plain_text, shortened

MAX_SESSIONS, MAX_NAME_LENGTH = 10, 60
RECENT_SETTING = "recent"


def kept_texts(settings: QSettings, name: str) -> list[str]:
    """Return a list of texts from the settings; empty if there is none."""
    kept = settings.value(name, [])
    # Qt returns a list of one text as a text.
    return [kept] if isinstance(kept, str) else kept if isinstance(kept, list) else []


class RecentMenu(QMenu):
    """Up to `MAX_SESSIONS` sessions by name, the newest first; missing folders are left out."""

    chosen = Signal(object)  # `Path` of the folder

    def __init__(self, settings: QSettings, parent: QWidget | None = None) -> None:
        super().__init__("&Recent sessions", parent)
        self._settings = settings
        self.setToolTipsVisible(True)
        self.aboutToShow.connect(self.fill)
        # An empty menu might not open.
        self._add_none()

    def remember(self, folder: Path) -> None:
        path = str(folder.absolute())
        others = [other for other in kept_texts(self._settings, RECENT_SETTING) if other != path]
        self._settings.setValue(RECENT_SETTING, [path, *others][:MAX_SESSIONS])

    def fill(self) -> None:
        """List the folders that still exist, and forget the others."""
        there = [path for path in kept_texts(self._settings, RECENT_SETTING) if _is_there(path)]
        self._settings.setValue(RECENT_SETTING, there)
        self.clear()
        for number, path in enumerate(there, 1):
            # An ampersand in a name would become a key.
            name = shortened(plain_text(Path(path).name), MAX_NAME_LENGTH).replace("&", "&&")
            action = self.addAction(f"&{number % MAX_SESSIONS}  {name}")
            action.setToolTip(escape_tooltip(plain_text(path)))
            action.triggered.connect(lambda _checked=False, path=path: self.chosen.emit(Path(path)))
        if not there:
            self._add_none()

    def _add_none(self) -> None:
        self.addAction("None yet").setEnabled(False)


def _is_there(path: str) -> bool:
    try:
        return Path(path).is_dir()
    except OSError:  # no rights on a folder above it
        return False

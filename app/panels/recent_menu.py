"""The menu of the sessions that were open last."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtCore import QSettings, Signal
from PySide6.QtWidgets import QMenu, QWidget

from app.panels.widgets import plain_tip
from skincal.model.errors import plain_text, shortened

MOST = 10
NAME_MOST = 60
"""Letters of a name."""
SETTING = "recent"


def kept_texts(settings: QSettings, name: str) -> list[str]:
    """Return a list of texts that was remembered; empty where there is none."""
    kept = settings.value(name, [])
    # A list of one is a text to Qt, and an empty one nothing.
    return [kept] if isinstance(kept, str) else kept if isinstance(kept, list) else []


class RecentMenu(QMenu):
    """Up to `MOST` sessions by their names, the newest first; one that is gone is left out as the menu opens."""

    chosen = Signal(object)
    """`Path` of the folder."""

    def __init__(self, settings: QSettings, parent: QWidget | None = None) -> None:
        super().__init__("&Recent sessions", parent)
        self._settings = settings
        self.setToolTipsVisible(True)
        self.aboutToShow.connect(self.fill)
        # A menu that is empty might not open; folders are looked at only then.
        self._say_none()

    def remember(self, folder: Path) -> None:
        """Put a session first."""
        path = str(folder.absolute())
        others = [other for other in kept_texts(self._settings, SETTING) if other != path]
        self._settings.setValue(SETTING, [path, *others][:MOST])

    def fill(self) -> None:
        """List what is still there, and forget what is not."""
        there = [path for path in kept_texts(self._settings, SETTING) if _is_there(path)]
        self._settings.setValue(SETTING, there)
        self.clear()
        for number, path in enumerate(there, 1):
            # Names are strangers': an ampersand would be taken for a key.
            name = shortened(plain_text(Path(path).name), NAME_MOST).replace("&", "&&")
            action = self.addAction(f"&{number % MOST}  {name}")
            action.setToolTip(plain_tip(plain_text(path)))
            action.triggered.connect(lambda _checked=False, path=path: self.chosen.emit(Path(path)))
        if not there:
            self._say_none()

    def _say_none(self) -> None:
        self.addAction("None yet").setEnabled(False)


def _is_there(path: str) -> bool:
    try:
        return Path(path).is_dir()
    except OSError:  # a folder above it may not be looked into any more
        return False

"""The menu of recent sessions."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtCore import QSettings, Signal
from PySide6.QtWidgets import QMenu, QWidget

from app.panels.widgets import escape_tooltip
from skincal.model.errors import plain_text, shortened

MAX_SESSIONS, MAX_NAME_LENGTH = 10, 60
RECENT_SETTING = "recent"
RECENT_PARTS_SETTING = "recent_parts"  # Names of the parts, in the same order


def kept_texts(settings: QSettings, name: str) -> list[str]:
    """Return a list of texts from the settings; empty if there is none."""
    kept = settings.value(name, [])
    # Qt returns a list of one text as a text.
    return [kept] if isinstance(kept, str) else kept if isinstance(kept, list) else []


class RecentMenu(QMenu):
    """Up to `MAX_SESSIONS` sessions by the names of folder and part, the newest first; missing folders are left out."""

    chosen = Signal(object)  # `Path` of the folder

    def __init__(self, settings: QSettings, parent: QWidget | None = None) -> None:
        super().__init__("&Recent sessions", parent)
        self._settings = settings
        self.setToolTipsVisible(True)
        self.aboutToShow.connect(self.fill)
        # An empty menu might not open.
        self._add_none()

    def remember(self, folder: Path, part: str = "") -> None:
        """Put a session first; `part` is the name of its part, empty if it is not known now."""
        path, known = str(folder.absolute()), self._entries()
        name = part or next((named for other, named in known if other == path), "")
        self._write_settings([(path, name), *(each for each in known if each[0] != path)][:MAX_SESSIONS])

    def _entries(self) -> list[tuple[str, str]]:
        """Paths and names of parts; the settings of older versions have no names."""
        paths, names = kept_texts(self._settings, RECENT_SETTING), kept_texts(self._settings, RECENT_PARTS_SETTING)
        return list(zip(paths, [*names, *[""] * len(paths)], strict=False))

    def _write_settings(self, sessions: list[tuple[str, str]]) -> None:
        self._settings.setValue(RECENT_SETTING, [path for path, _ in sessions])
        self._settings.setValue(RECENT_PARTS_SETTING, [name for _, name in sessions])

    def fill(self) -> None:
        """List the folders that still exist, and forget the others."""
        there = [(path, part) for path, part in self._entries() if _is_there(path)]
        self._write_settings(there)
        self.clear()
        for number, (path, part) in enumerate(there, 1):
            shown = (shortened(plain_text(each), MAX_NAME_LENGTH) for each in (Path(path).name, part))
            # An ampersand in a name would become a key.
            name = "   ".join(filter(None, shown)).replace("&", "&&")
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

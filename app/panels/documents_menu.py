"""The menu of the pages that the program ships with."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtCore import QUrl, Signal
from PySide6.QtGui import QDesktopServices
from PySide6.QtWidgets import QMenu, QWidget

from app.text.help_text import NO_DOCUMENTS, unopened_words

FOLDER = Path(__file__).resolve().parents[2] / "docs"
"""Beside the program in a checkout; a package comes without."""
PAGES = {
    "&Manual": "manual.md",
    "&Scene files": "scene.md",
    "&Devices": "devices.md",
    "&Wire formats": "wire.md",
    "&Guide": "guidance.md",
    "M&odules and rig": "modules-and-rig.md",
    "&Noise": "noise.md",
    "M&ethods": "method.md",
    "What is &trusted": "security.md",
}


class DocumentsMenu(QMenu):
    """One entry a page, which the desktop opens."""

    failed = Signal(str)
    """Why nothing opens, and where the page is."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__("&Documents", parent)
        for words, name in PAGES.items():
            self.addAction(words).triggered.connect(lambda _checked=False, name=name: self._open(name))

    def _open(self, name: str) -> None:
        page = FOLDER / name
        if not page.is_file():
            self.failed.emit(NO_DOCUMENTS.format(name=name))
        elif not QDesktopServices.openUrl(QUrl.fromLocalFile(str(page))):
            self.failed.emit(unopened_words(page))

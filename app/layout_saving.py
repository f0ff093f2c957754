"""How the operator gets the corrected layout: a file is asked for, and written beside the window."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

from PySide6.QtWidgets import QFileDialog, QWidget

from app.compare_words import saved_words
from app.panels.message_bar import Message
from skincal.model.scene import Scene
from skincal.modules.health import LayoutMend


class Compute(Protocol):
    """Does work beside the window, and hands over its result or the sentence why there is none."""

    def __call__(self, work: Callable[[], Any], done: Callable[[Any], None], failed: Callable[[str], None]) -> None:
        """Start the work."""
        ...


def ask_layout(
    parent: QWidget, documents: Path, scene: Scene, mend: LayoutMend, compute: Compute, say: Callable[[Message], None]
) -> None:
    """Ask for a file, write the corrected layout there, and say where it is or why it is not.

    Parameters
    ----------
    documents : where files go unless the operator says otherwise
    scene : whose layout it is
    mend : of that layout
    """
    given = scene.skin.layout
    if given is None:
        return
    # A folder that is not there yet would stand in the dialog as a file's name.
    folder = documents if documents.is_dir() else Path.home()
    name = str(folder / f"{scene.name}-corrected.modules.toml")
    chosen, _ = QFileDialog.getSaveFileName(parent, "Save the corrected layout", name, "Layout (*.toml)")
    if not chosen:
        return
    path = Path(chosen)

    def write() -> None:
        from skincal.files.layout_file import write_layout

        write_layout(given, mend, path)

    compute(write, lambda _: say(Message(saved_words(path, mend))), lambda sentence: say(Message(sentence, error=True)))

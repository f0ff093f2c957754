"""Texts of the Help menu."""

from __future__ import annotations

import platform
from pathlib import Path

from skincal.version import __version__

NO_DOCUMENTS = "This copy of skincal has no documents; they are in the folder docs of the source."
LICENCE_SENTENCE = "BSD 3-Clause License: you may use, change and pass it on with its copyright notice, without any warranty."


def unopened_words(folder: Path) -> str:
    """Say that the desktop cannot open the documents."""
    return f"No program of this desktop opens {folder}. The documents there are text files for any editor."


def about_words(qt: str) -> str:
    """Describe the program, its version and licence; `qt` is Qt's version."""
    return (
        f"skincal {__version__}\n\nLocates the taxels of a robot's skin from pokes.\n\n"
        f"Copyright 2026, skincal authors. {LICENCE_SENTENCE}\n\n"
        f"Runs on Python {platform.python_version()} and Qt {qt} (LGPL), {platform.system()} {platform.machine()}."
    )

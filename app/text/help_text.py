"""What the Help menu says of the program."""

from __future__ import annotations

import platform
from pathlib import Path

from skincal import __version__

NO_DOCUMENTS = "This copy of skincal came without its documents; {name} is in the folder docs of its source."
LICENCE = "BSD 3-Clause License: it may be used, changed and passed on, with its copyright notice and without any warranty."


def unopened_words(page: Path) -> str:
    """Return what is said where the desktop opens no such file."""
    return f"Nothing on this desktop opens {page}; it is a text, and any editor shows it."


def about_words(qt: str) -> str:
    """Return what the program is, its version and licence; `qt` is Qt's version."""
    return (
        f"skincal {__version__}\n\nFinds where the taxels of a robot's skin are, from pokes.\n\n"
        f"Copyright 2026, skincal authors. {LICENCE}\n\n"
        f"Runs on Python {platform.python_version()} and Qt {qt} (LGPL), {platform.system()} {platform.machine()}."
    )

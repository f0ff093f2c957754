"""What a process that the window starts is told of where the program lies."""

from __future__ import annotations

import os
from pathlib import Path

from PySide6.QtCore import QProcessEnvironment

import skincal


def child_environment() -> QProcessEnvironment:
    """Return this process's environment, with the package where a child finds it: the window may run in another folder."""
    environment = QProcessEnvironment.systemEnvironment()
    paths = [str(Path(skincal.__file__).resolve().parent.parent), environment.value("PYTHONPATH")]
    environment.insert("PYTHONPATH", os.pathsep.join(filter(None, paths)))
    return environment

"""Common base of the two commands: the required Python, the checkout's paths and the output.

Written so that any Python since 3.6 can read it.
"""

import os
import sys
from pathlib import Path

MIN_PYTHON = (3, 11)
MAX_PYTHON = (3, 14)
"""The newest version with packages in requirements.lock."""

CHECKOUT = Path(__file__).resolve().parent.parent
VENV = CHECKOUT / ".venv"
SYSTEM = VENV / "system"
"""System packages unpacked without root."""
RUN_LOCK = CHECKOUT / "requirements.lock"
TEST_LOCK = CHECKOUT / "requirements-dev.lock"
"""Contains everything of RUN_LOCK."""

EXIT_CODE_USER_CAN_MEND = 2
"""Exit code of StopError: the user must change something first."""


class StopError(Exception):
    """The command cannot continue; the text has the reason and the remedy."""


def require_python() -> None:
    """End the program with exit code 2 if this Python is too old or too new."""
    if MIN_PYTHON <= sys.version_info[:2] <= MAX_PYTHON:
        return
    needed = f"{MIN_PYTHON[0]}.{MIN_PYTHON[1]} to {MAX_PYTHON[0]}.{MAX_PYTHON[1]}"
    this = f"{sys.version_info[0]}.{sys.version_info[1]} at {sys.executable}"
    say(f"skincal needs Python {needed}; this is Python {this}.")
    say(f"Run it with another one, for example: python3.12 {sys.argv[0]}")
    sys.exit(EXIT_CODE_USER_CAN_MEND)


def interpreter() -> Path:
    """Python inside `.venv`."""
    return VENV / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


def say(sentence: str) -> None:
    """Print a sentence on stderr."""
    print(sentence, file=sys.stderr, flush=True)

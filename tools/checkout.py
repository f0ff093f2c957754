"""Common base of the two commands: the required Python, the checkout's paths and the output.

Written so that any Python since 3.6 can read it.
"""

import os
import sys
from pathlib import Path

OLDEST = (3, 11)
NEWEST = (3, 14)
"""The newest that requirements.lock has packages for."""

CHECKOUT = Path(__file__).resolve().parent.parent
VENV = CHECKOUT / ".venv"
SYSTEM = VENV / "system"
"""System packages unpacked without root."""
RUN_LOCK = CHECKOUT / "requirements.lock"
TEST_LOCK = CHECKOUT / "requirements-dev.lock"
"""Contains everything of RUN_LOCK."""

USER_CAN_HELP = 2
"""Exit code: something about this machine has to change first, and the sentence says what."""


class StopError(Exception):
    """The command cannot go on; its text names the reason and the remedy."""


def require_python() -> None:
    """End the program with a sentence and exit code 2 where this Python is too old or too new."""
    if OLDEST <= sys.version_info[:2] <= NEWEST:
        return
    needed = f"{OLDEST[0]}.{OLDEST[1]} to {NEWEST[0]}.{NEWEST[1]}"
    this = f"{sys.version_info[0]}.{sys.version_info[1]} at {sys.executable}"
    say(f"skincal needs Python {needed}; this is Python {this}.")
    say(f"Run it with another one, for example: python3.12 {sys.argv[0]}")
    sys.exit(USER_CAN_HELP)


def interpreter() -> Path:
    """Python inside `.venv`."""
    return VENV / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


def say(sentence: str) -> None:
    """Tell the person at the terminal what happens now."""
    print(sentence, file=sys.stderr, flush=True)

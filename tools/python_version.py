"""Refuse a Python that cannot run skincal; written so that any Python since 3.6 can read it."""

import sys

OLDEST = (3, 11)
NEWEST = (3, 14)
"""The newest that requirements.lock has packages for."""


def require() -> None:
    """End the program with a sentence and exit code 2 where this Python is too old or too new."""
    if OLDEST <= sys.version_info[:2] <= NEWEST:
        return
    needed = f"{OLDEST[0]}.{OLDEST[1]} to {NEWEST[0]}.{NEWEST[1]}"
    this = f"{sys.version_info[0]}.{sys.version_info[1]} at {sys.executable}"
    sys.stderr.write(f"skincal needs Python {needed}; this is Python {this}.\n")
    sys.stderr.write(f"Run it with another one, for example: python3.12 {sys.argv[0]}\n")
    sys.exit(2)

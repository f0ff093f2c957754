"""What the two commands say, and how they end."""

from __future__ import annotations

import sys

USER_CAN_HELP = 2
"""Exit code: something about this machine has to change first, and the sentence says what."""
OURS = 1
"""Exit code: an installation step failed for a reason nobody foresaw."""


class StopError(Exception):
    """The command cannot go on; its text says what was found and what to do."""

    def __init__(self, sentence: str, code: int = USER_CAN_HELP) -> None:
        super().__init__(sentence)
        self.code = code


def say(sentence: str) -> None:
    """Tell the person at the terminal what happens now."""
    print(sentence, file=sys.stderr, flush=True)


def say_over(sentence: str) -> None:
    """Replace the last line on a terminal; say nothing where the output is kept in a file."""
    if sys.stderr.isatty():
        print(f"\r\033[K{sentence[:100]}", end="", file=sys.stderr, flush=True)

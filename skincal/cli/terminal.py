"""What a command prints: every line of it goes through here, since devices, files and sessions of others have words in it."""

from __future__ import annotations

import sys
import time

import typer

from skincal.model.errors import plain_text

PROGRESS_UPDATE_PERIOD_S = 0.5
"""Between two updates of the progress on a terminal..."""
PROGRESS_LINE_IN_FILE_PERIOD_S = 10.0
"""...and between two lines of it in a file."""
SHOW_TIME_LEFT_AFTER_S = 2.0
"""The time left is estimated after this time."""


def say(text: str, *, err: bool = False) -> None:
    """Print one line on stdout or stderr, without control characters: see `plain_text`."""
    typer.echo(plain_text(text), err=err)  # noqa: TID251 - the one place


class ProgressLine:
    """Progress of a long command on stderr, with the time left: one changing line on a terminal, else a line every 10 s.

    Parameters
    ----------
    title : what is done, such as "import"
    """

    def __init__(self, title: str) -> None:
        self._title = title
        self._is_terminal = sys.stderr.isatty()
        self._begin_s = self._last_s = time.monotonic()
        self._is_shown = False

    def show(self, share: float) -> None:
        """Show the finished share, 0 to 1."""
        now_s = time.monotonic()
        if now_s - self._last_s < (PROGRESS_UPDATE_PERIOD_S if self._is_terminal else PROGRESS_LINE_IN_FILE_PERIOD_S):
            return
        self._last_s, elapsed_s = now_s, now_s - self._begin_s
        left = f", {elapsed_s / share - elapsed_s:.0f} s left" if share > 0 and elapsed_s >= SHOW_TIME_LEFT_AFTER_S else ""
        text = f"{self._title}: {share:.0%}{left}"
        if self._is_terminal:
            typer.echo(f"\r{text}\x1b[K", nl=False, err=True)  # noqa: TID251 - rewrites the line
            self._is_shown = True
        else:
            say(text, err=True)

    def clear(self) -> None:
        """Remove the line from the terminal."""
        if self._is_shown:
            typer.echo("\r\x1b[K", nl=False, err=True)  # noqa: TID251 - rewrites the line
            self._is_shown = False

"""What a command prints: every line of it goes through here, since devices, files and sessions of others have words in it."""

from __future__ import annotations

import typer

from skincal.model.errors import plain_text


def say(text: str, *, err: bool = False) -> None:
    """Print one line on stdout or stderr, without control characters: see `plain_text`."""
    typer.echo(plain_text(text), err=err)  # noqa: TID251 - the one place

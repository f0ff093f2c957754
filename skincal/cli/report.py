"""`report`: what a session came to, as one file for the browser and for paper."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from skincal.cli.solve import Correct, Json, SessionArgument
from skincal.model.errors import InputError
from skincal.taxels.result import Method

PAGE_SUFFIXES = (".html", ".htm")


def add_to(app: typer.Typer) -> None:
    """Add the command of this module."""
    app.command(epilog="Example: skincal report my-session --out report.html")(report)


def report(
    session: SessionArgument,
    out: Annotated[Path, typer.Option(help="File to write (*.html); an older one is kept as .bak, .bak-2, ...")],
    method: Annotated[
        Method | None,
        typer.Option(
            help="Method whose estimates are shown; default: the one with the smallest predicted error.", show_default=False
        ),
    ] = None,
    correct: Correct = False,
    as_json: Json = False,
) -> None:
    """Write the report of a session: verdict and evidence, pictures, errors, rig, pokes, settings and versions in one file."""
    from skincal.cli import output
    from skincal.interface.session import Session

    if out.suffix.lower() not in PAGE_SUFFIXES:
        raise InputError(f"{out}: a report is a page for the browser; expected --out with a name that ends in .html.")
    verdict = Session.load(session, correct=correct).report(out, None if method is None else method.value)
    output.print_result({"file": out, "verdict": verdict}, [verdict, f"wrote {out}"], as_json)

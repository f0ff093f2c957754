"""`study`: measure the program itself, and write the numbers and a figure."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skincal.cli.solve import Json
from skincal.cli.terminal import say
from skincal.model.errors import InputError
from skincal.studies import STUDIES, load_study

if TYPE_CHECKING:
    from skincal.studies.harness import Study

DEFAULT_FOLDER = Path("studies")
Quick = Annotated[bool, typer.Option("--quick", help="A shorter version: at most 90 s on two idle cores.")]
Out = Annotated[
    Path | None,
    typer.Option(
        help="Folder for NAME.json, NAME.svg and NAME.png. Default: ./studies; with --json no file is written.",
        show_default=False,
    ),
]
_studies = typer.Typer(
    help="Measure the accuracy and speed of the program: numbers and a figure.",
    no_args_is_help=True,
    epilog="Example: skincal study runtime --quick --out measured",
)


def add_to(app: typer.Typer) -> None:
    """Add a command for each study."""
    for name, entry in STUDIES.items():
        example = f"Examples: skincal study {name} --quick --out measured; skincal study {name} --json"
        _studies.command(name, help=entry.purpose, epilog=example)(_command(name))
    app.add_typer(_studies, name="study")


def _command(name: str) -> Callable[..., None]:
    # Typer reads the options from a function's signature: each study gets a function of its own.
    def command(quick: Quick = False, as_json: Json = False, out: Out = None) -> None:
        study = load_study(name)
        folder = DEFAULT_FOLDER if out is None and not as_json else out
        if folder is not None:
            _check_folder(folder, name)
        result = study.run(quick, _say)
        text = json.dumps(result, allow_nan=False)
        written = [] if folder is None else _write(study, name, result, folder)
        if as_json:
            say(text)
        else:
            for line in (*study.summary(result), *(f"wrote {path}" for path in written)):
                say(line)
        if result.get("misses"):
            raise typer.Exit(1)

    return command


def _say(sentence: str) -> None:
    say(sentence, err=True)


def _check_folder(folder: Path, name: str) -> None:
    """Make the folder and see that files can be written there, now rather than after minutes of measuring."""
    try:
        for path in (folder / f"{name}.{ending}" for ending in ("json", "svg", "png")):
            if path.is_dir():
                raise InputError(f"{path}: a folder is in the way of the file; move it, or choose another folder by --out.")
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=folder, prefix=".skincal-"):
            pass
    except OSError as error:
        why = os.strerror(error.errno) if error.errno else str(error)
        raise InputError(f"{folder}: is no folder that can be written to ({why}); choose another by --out.") from None


def _write(study: Study[Any], name: str, result: dict[str, Any], folder: Path) -> list[Path]:
    kinds = ("svg", "png")
    pictures = study.pictures(result, kinds)
    files = {"json": (json.dumps(result, indent=1, allow_nan=False) + "\n").encode(), **dict(zip(kinds, pictures, strict=True))}
    written: list[Path] = []
    for ending, data in files.items():
        path = folder / f"{name}.{ending}"
        try:
            path.write_bytes(data)
        except OSError as error:
            raise InputError(f"{path}: cannot be written ({error.strerror}); choose another folder by --out.") from None
        written.append(path)
    return written

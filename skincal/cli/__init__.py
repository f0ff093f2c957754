"""The commands of `skincal`.

Results go to stdout, as text or with `--json` as one JSON value; everything else goes to stderr. Exit codes: 0 done,
2 the user's input is at fault (one sentence, no traceback), 1 ours.
"""

from __future__ import annotations

import re
import sys
import traceback
from collections.abc import Sequence
from functools import cache
from importlib import import_module
from typing import Any

import typer

from skincal.child_environment import protect_children
from skincal.cli.terminal import say
from skincal.model.errors import InputError, shortened
from skincal.version import __version__

app = typer.Typer(
    name="skincal",
    help="Find where every taxel of a robot skin is, from pokes measured by a force/torque sensor. "
    "Without a command the window opens; it takes --scene, --wrench, --skin, --joints, --tip, --tool, --targets PORT "
    "and --new FOLDER, or --session FOLDER, or --headless.",
    epilog="Example: skincal simulate --scene icub-forearm --pokes 252 --out trial, then skincal solve trial --out results",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _show_version(wanted: bool) -> None:
    if wanted:
        say(f"skincal {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: bool = typer.Option(False, "--version", callback=_show_version, is_eager=True, help="Print the version."),
) -> None:
    pass


COMMAND_MODULES = (
    "scene",
    "solve",
    "apply",
    "compare",
    "report",
    "devices",
    "landmarks",
    "pokes",
    "tool",
    "record",
    "import_recording",
    "simulate",
    "study",
)
"""Modules of this package with commands, in the order of the help. Each has `add_to(app)`."""
OPENING_BRACKET_RE = re.compile(r"(\[[a-z])")
"""Beginning of markup for rich."""


def _prepare_help(command: Any) -> None:
    """Leave the type of flags out of the help, and keep words in brackets such as `[tool]`.

    `--serve <bool>` looks as if a value followed. Rich takes words in brackets for markup and drops them.
    `command` is a command or group of click, or of the copy of click inside newer versions of typer.
    """
    for parameter in command.params:
        if getattr(parameter, "is_flag", False):
            parameter.metavar = ""
        if app.rich_markup_mode == "rich" and getattr(parameter, "help", None):
            parameter.help = OPENING_BRACKET_RE.sub(r"\\\1", parameter.help)
    for each in getattr(command, "commands", {}).values():
        _prepare_help(each)


@cache
def _commands() -> Any:
    """Make the commands, once; a function, so that each module is imported after `app` exists."""
    for name in COMMAND_MODULES:
        import_module(f"skincal.cli.{name}").add_to(app)
    commands = typer.main.get_command(app)
    _prepare_help(commands)
    return commands


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code.

    Parameters
    ----------
    arguments : without the program's name; those of the process when None
    """
    protect_children()
    try:
        words = None if arguments is None else list(arguments)
        # Not standalone: it would end the process and print errors in its own words.
        result = _commands().main(args=words, prog_name="skincal", standalone_mode=False)
    except InputError as error:
        say(f"skincal: {error}", err=True)
        return 2
    except typer.Abort:
        return 2
    except Exception as error:  # noqa: BLE001 - the last handler: a usage error, or a fault of ours that is shown whole
        return _other_failure(error)
    return result if isinstance(result, int) else 0


_PLAIN_WORDS = (
    ("Value error, ", ""),
    ("Input should be greater", "expected a number greater"),
    ("Input should be less", "expected a number less"),
    ("Input should be a valid integer", "expected a whole number"),
    ("Input should be a valid", "expected a"),
    (", unable to parse string as a number", ""),
    (", unable to parse string as an integer", ""),
    ("Unable to parse input string as an integer, exceeded maximum size", "expected a whole number of fewer digits"),
    ("Input should be", "expected"),
)
"""Phrases of pydantic, which checks typer's options, and their plain words for an operator."""


def _usage_sentence(message: str, command: str) -> str:
    for theirs, plain in _PLAIN_WORDS:
        message = message.replace(theirs, plain)
    end = "" if message.endswith("?") else ";"
    return "skincal: " + shortened(f"{message.rstrip('.')}{end} `{command} --help` shows what is possible.")


def _other_failure(error: Exception) -> int:
    """Report a usage error as the user's, any other exception as the program's."""
    # A ClickException, with its words: typer carries its own copy of click, or uses the installed one.
    show, words = getattr(error, "show", None), getattr(error, "format_message", str)
    if show is not None:
        message, context = words(), getattr(error, "ctx", None)
        if not message or ("\n" in message and getattr(error, "param", None) is None):  # no command was named: the whole help
            show()
        else:
            say(_usage_sentence(" ".join(message.split()), getattr(context, "command_path", "skincal")), err=True)
        return 2
    # Who reads the output has seen enough, such as `head`.
    if isinstance(error, BrokenPipeError):
        return 0
    # A name that is too long, a folder without rights: the system's word is the reason.
    if isinstance(error, OSError) and error.filename is not None:
        sentence = InputError(f"{error.filename}: cannot be used ({error.strerror}); check the path and its rights.")
        say(f"skincal: {sentence}", err=True)
        return 2
    traceback.print_exception(error, file=sys.stderr)
    say(f"skincal: {error!r} is a fault of skincal, not of your input; please report it with the lines above.", err=True)
    return 1

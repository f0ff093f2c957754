"""Update the lock files from pyproject.toml: `python3 tools/lock.py [--upgrade]`. Needs uv (`pip install uv`).

The locks hold for CPython 3.11 to 3.14 on Linux, Windows and macOS, list a hash for every file, and name no host. Only wheels
count: an installation needs no compiler. The one for tests keeps the versions of the other.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

CHECKOUT_FOLDER = Path(__file__).resolve().parent.parent
UV_OPTIONS = (
    "--universal",
    "--python-version=3.11",
    "--only-binary=:all:",
    "--generate-hashes",
    "--no-emit-index-url",
    "--no-emit-find-links",
    "--custom-compile-command=python3 tools/lock.py",
    "--quiet",
)


def main() -> int:
    """Resolve the packages of the program, those of the tests, and the installer."""
    # The second is bound to the first, so that one .venv serves both commands.
    for own in (
        ("requirements.lock", "pyproject.toml"),
        ("requirements-dev.lock", "pyproject.toml", "--group=dev", "--constraints=requirements.lock"),
        ("requirements-uv.lock", "--group=install"),
    ):
        output, *options = own
        command = ["uv", "pip", "compile", f"--output-file={output}", *UV_OPTIONS, *options, *sys.argv[1:]]
        code = subprocess.call(command, cwd=CHECKOUT_FOLDER)
        if code:
            return code
    return 0


def select_packages(lock: str, names: Iterable[str]) -> str:
    """Select the packages of these names, and those they need, from the text of a lock: a comment names who needs each."""
    blocks = re.split(r"^(?=[A-Za-z0-9])", lock, flags=re.MULTILINE)[1:]
    users_of: dict[str, set[str]] = {}
    for block in blocks:  # one package may have several, each for some versions of Python
        users_of.setdefault(_package_of(block), set()).update(re.findall(r"^ +# (?:via|  )\s*(\S+)", block, re.MULTILINE))
    selected, waiting = set[str](), set(names)
    while waiting:
        selected |= waiting
        waiting = {name for name, users in users_of.items() if users & selected} - selected
    return "".join(block for block in blocks if _package_of(block) in selected)


def _package_of(block: str) -> str:
    return re.split(r"[=\s]", block, maxsplit=1)[0]


if __name__ == "__main__":
    sys.exit(main())

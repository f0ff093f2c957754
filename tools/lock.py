"""Update both lock files from pyproject.toml: `python3 tools/lock.py [--upgrade]`. Needs uv (`pip install uv`).

The locks hold for CPython 3.11 to 3.14 on Linux, Windows and macOS, list a hash for every file, and name no host. Only wheels
count: an installation needs no compiler. The one for tests keeps the versions of the other.
"""

from __future__ import annotations

import subprocess
import sys
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
    """Resolve the packages of the program, then those of the tests."""
    # The second is bound to the first, so that one .venv serves both commands.
    for own in (("requirements.lock",), ("requirements-dev.lock", "--group=dev", "--constraints=requirements.lock")):
        output, *options = own
        command = ["uv", "pip", "compile", "pyproject.toml", f"--output-file={output}", *UV_OPTIONS, *options, *sys.argv[1:]]
        code = subprocess.call(command, cwd=CHECKOUT_FOLDER)
        if code:
            return code
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Programs in environments of their own: each has its packages, and disturbs neither the tests nor another program."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import venv
from pathlib import Path
from typing import Any

import pytest

READERS = Path(__file__).parent / "readers"
ENVIRONMENTS = Path(__file__).resolve().parents[3] / "out" / "consumers"
PACKAGES = {
    "idyntree": ("idyntree==15.1.0", "numpy==2.4.6"),
    "pybullet": ("pybullet==3.2.7", "numpy==2.4.6"),
    "urchin": ("urchin==0.0.30", "numpy==2.4.6"),
    "drake": ("drake==1.58.0",),
    "open3d": ("open3d==0.20.0", "numpy==2.4.6"),
    "pymeshlab": ("pymeshlab==2025.7.post1", "numpy==2.4.6"),
    "blender": ("bpy==5.0.1",),
    "nb_touch": ("nb-touch==0.1.0", "numpy==2.4.6"),
}
"""Tested versions, by reader."""
PYTHONS = {"drake": ("3.12", "3.13"), "blender": ("3.11",), "nb_touch": ("3.12", "3.13", "3.14")}
"""Versions of Python for which a program has wheels; the others have one for every version."""


def find_python(reader: str) -> str:
    """Find an interpreter for a program; skip the test if there is none."""
    own = f"{sys.version_info.major}.{sys.version_info.minor}"
    wanted = PYTHONS.get(reader, (own,))
    if own in wanted:
        return sys.executable
    for version in wanted:
        found = shutil.which(f"python{version}")
        # A shim of pyenv is there also without the version.
        if found and subprocess.run([found, "-c", ""], capture_output=True, check=False).returncode == 0:
            return found
    pytest.skip(f"{reader} has wheels for Python {' and '.join(wanted)}; none of them is installed")


def environment(reader: str) -> Path:
    """Return the interpreter of a program's environment, which is made before its first use."""
    folder = ENVIRONMENTS / reader
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    done = folder / "packages.json"
    if not done.exists() or json.loads(done.read_text()) != list(PACKAGES[reader]):
        shutil.rmtree(folder, ignore_errors=True)
        base = find_python(reader)
        if base == sys.executable:
            venv.create(folder, with_pip=True)
        else:
            subprocess.run([base, "-m", "venv", folder], check=True)
        pip = [python, "-m", "pip", "install", "-q", "--disable-pip-version-check", "--only-binary=:all:"]
        made = subprocess.run([*pip, *PACKAGES[reader]], capture_output=True, text=True, check=False)
        if made.returncode:
            shutil.rmtree(folder)
            pytest.skip(f"{reader} cannot be installed: {made.stderr.strip().splitlines()[-1]}")
        done.write_text(json.dumps(PACKAGES[reader]))
    return python


def read_with(reader: str, tmp_path: Path, **task: Any) -> tuple[dict[str, Any], str]:
    """Run a reader on a task; return its result and all that the program printed."""
    result = tmp_path / f"{reader}.json"
    result.unlink(missing_ok=True)
    words = json.dumps({key: str(value) if isinstance(value, Path) else value for key, value in task.items()})
    command = [environment(reader), READERS / f"{reader}_reader.py", words, result]
    done = subprocess.run(command, capture_output=True, text=True, timeout=200, check=False)
    if "cannot open shared object file" in done.stderr:
        pytest.skip(f"{reader} needs a library of the system: {done.stderr.strip().splitlines()[-1]}")
    assert done.returncode == 0, done.stderr
    return json.loads(result.read_text()), done.stdout + done.stderr

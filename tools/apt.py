"""System packages on Debian, Ubuntu and their kin: installed as root, unpacked beside the checkout's Python otherwise."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from tools.words import StopError, say

NEVER_UNPACKED = frozenset({"libc6", "libc-bin", "libgcc-s1", "libstdc++6"})
"""A second C library beside the system's own crashes whatever loads it."""


def is_here() -> bool:
    """Whether this system installs packages with apt."""
    return bool(shutil.which("apt-get") and shutil.which("dpkg-deb"))


def line_for(packages: Sequence[str]) -> str:
    """Return the command that installs the packages, for a person to run."""
    return f"sudo apt-get install --no-install-recommends {' '.join(packages)}"


def provide(packages: Sequence[str], unpacked: Path) -> None:
    """Make packages available: install them as root, otherwise unpack them and what they depend on under `unpacked`.

    Raises
    ------
    StopError
        The packages could not be had; the sentence has the line that installs them.
    """
    if os.geteuid() == 0:
        _install(packages)
    else:
        _unpack(packages, unpacked)


def _install(packages: Sequence[str]) -> None:
    say(f"Installing system packages (apt-get install): {' '.join(packages)}")
    environment = os.environ | {"DEBIAN_FRONTEND": "noninteractive"}
    # Its failure is not final: one unreachable source among many is common. The install tells.
    _run(["apt-get", "update", "-qq"], environment)
    command = ["apt-get", "install", "-y", "-qq", "--no-install-recommends", "-o", "DPkg::Lock::Timeout=300", *packages]
    failed = _run(command, environment)
    if failed.returncode:
        raise _failure(packages, failed)


def _unpack(packages: Sequence[str], unpacked: Path) -> None:
    say(f"Unpacking system packages into {unpacked} (no root needed): {' '.join(packages)}")
    own = _own_folders(unpacked / "apt")
    _run(["apt-get", *own, "update", "-qq"])
    plan = _run(["apt-get", *own, "install", "--simulate", "--no-install-recommends", *packages])
    if plan.returncode:
        raise _failure(packages, plan)
    archives = unpacked / "apt" / "archives"
    for name, version in re.findall(r"^Inst (\S+) (?:\[\S+\] )?\((\S+)", plan.stdout, re.MULTILINE):
        if name.partition(":")[0] in NEVER_UNPACKED:
            continue
        fetched = _run(["apt-get", *own, "download", f"{name}={version}"], folder=archives)
        if fetched.returncode:
            raise _failure(packages, fetched)
    for archive in sorted(archives.glob("*.deb")):
        done = _run(["dpkg-deb", "-x", str(archive), str(unpacked)])
        if done.returncode:
            raise _failure(packages, done)
    shutil.rmtree(unpacked / "apt")


def _own_folders(folder: Path) -> list[str]:
    """Options that keep apt's lists and downloads out of the system's folders, which only root may write."""
    for part in ("lists/partial", "archives/partial"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    return ["-o", f"Dir::State::lists={folder}/lists", "-o", f"Dir::Cache={folder}", "-o", "Debug::NoLocking=true"]


def _run(
    command: Sequence[str], environment: dict[str, str] | None = None, folder: Path | None = None
) -> subprocess.CompletedProcess[str]:
    english = (environment or dict(os.environ)) | {"LC_ALL": "C"}
    return subprocess.run(
        command, env=english, cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )


def _failure(packages: Sequence[str], failed: subprocess.CompletedProcess[str]) -> StopError:
    said = (failed.stderr or failed.stdout).strip().splitlines()
    reason = said[-1] if said else f"exit code {failed.returncode}"
    return StopError(
        f"System packages are missing and apt-get could not provide them: {reason}\n"
        f"Check the network, or install them by hand:  {line_for(packages)}"
    )

"""Replace a file so that a crash or a full disk leaves the old one whole."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from skincal.model.errors import InputError


def write_atomically(path: Path, data: bytes) -> None:
    """Write `data` to `path`; an older file stays beside it with `.bak` after its name.

    The bytes are on the disk before the name changes, so `path` is at every moment the old file or the new one.

    Raises InputError: the folder is missing, the path is a folder, or the disk refuses; an older file is as it was.
    """
    if path.is_dir():
        raise InputError(f"{path}: is a folder; expected the name of a file to write.")
    if not path.parent.is_dir():
        raise InputError(f"{path}: the folder {path.parent} does not exist; make it or choose another.")
    try:
        _replace(path, data)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); free some space or choose another folder.") from None


def _replace(path: Path, data: bytes) -> None:
    # With the process's number: another program may be writing the same file.
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with part.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        if path.exists():
            _keep_old(path)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def _keep_old(path: Path) -> None:
    """Give the old file a second name, `.bak`, without a moment in which `path` is missing."""
    backup = path.with_name(path.name + ".bak")
    spare = path.with_name(f".{path.name}.bak.part")
    with suppress(FileNotFoundError):
        spare.unlink()
    try:
        spare.hardlink_to(path)
    except OSError:
        # A file system without hard links, such as FAT: the second name costs a copy.
        spare.write_bytes(path.read_bytes())
    spare.replace(backup)

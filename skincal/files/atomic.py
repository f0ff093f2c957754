"""Replace a file so that a crash or a full disk leaves the old one whole."""

from __future__ import annotations

import os
import re
import shutil
import stat
from itertools import count
from pathlib import Path

from skincal.model.errors import InputError

_SESSION_FILE_RE = re.compile(r"segment-\d{4}\.(mcap|jsonl)|session\.lock")


def write_atomically(path: Path, data: bytes, *, changes_session_scene: bool = False) -> Path | None:
    """Write `data` to `path` with the rights of the older file; return the path of its copy, `None` if there was none.

    The copy has `.bak` after its name, or `.bak-2` and so on if that is taken. The bytes are on the disk before the name
    changes, so `path` is at every moment the old file or the new one. With `changes_session_scene` it may be a file in the
    scene's copy of a session, which the operator changes.

    Raises InputError: the folder is missing, the path is a folder, a link, a device or part of a recorded session, or the disk
    refuses; the older file is unchanged.
    """
    try:
        _require_replaceable(path, changes_session_scene=changes_session_scene)
        return _replace(path, data)
    except (OSError, ValueError) as error:  # a name with a NUL is a ValueError
        why = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"{path}: cannot be written ({why}); free some space or choose another folder.") from None


def _require_replaceable(path: Path, *, changes_session_scene: bool) -> None:
    """Raise InputError: the path is something that an export must not replace."""
    if path.is_dir():
        raise InputError(f"{path}: is a folder; expected the name of a file to write.")
    if not path.parent.is_dir():
        raise InputError(f"{path}: the folder {path.parent} does not exist; make it or choose another.")
    if path.is_symlink():
        raise InputError(f"{path}: is a link; expected the name of a file to write, such as {path.name} in another folder.")
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: is a device or a pipe; expected the name of a file to write.")
    # The copy of a scene keeps the names of its files.
    in_scene = not changes_session_scene and path.parent.name == "scene" and (path.parent.parent / "segment-0001.mcap").exists()
    if _SESSION_FILE_RE.fullmatch(path.name) or in_scene:
        raise InputError(f"{path}: is part of a recorded session; choose another name.")


def _replace(path: Path, data: bytes) -> Path | None:
    # With the process's number: another program may be writing the same file.
    part = path.with_name(f".{path.name[:100]}.{os.getpid()}.part")
    part.unlink(missing_ok=True)
    kept = None
    try:
        with part.open("xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        if path.exists():
            part.chmod(stat.S_IMODE(path.stat().st_mode))
            kept = _keep_old(path)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
    return kept


def _keep_old(path: Path) -> Path:
    """Copy the old file to the first free name with `.bak`; return it."""
    for number in count(1):
        backup = path.with_name(f"{path.name}.bak{f'-{number}' if number > 1 else ''}")
        try:
            with path.open("rb") as source, backup.open("xb") as target:
                shutil.copyfileobj(source, target)
        except FileExistsError:
            continue
        except OSError:
            backup.unlink(missing_ok=True)
            raise
        return backup
    raise AssertionError("there is a next number")

"""The solver's program as this machine runs it, kept from one start to the next.

Compiling it takes 65 ms of processor time, reading it back half of one. What is read back is run as it stands, so a file counts
only if nobody but this user can have written it: a file and a folder of this user's that no other may write, whole by its
checksum. wasmtime itself refuses what another version of it, or another kind of processor, has made. Whatever is amiss, the
program is compiled anew. Windows has no such rights to ask for: nothing is kept there.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import stat
import sys
import tempfile
from pathlib import Path

import wasmtime

OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
_SUM = hashlib.sha256().digest_size


def compiled(engine: wasmtime.Engine, program: bytes) -> wasmtime.Module:
    """Return a WebAssembly program compiled for this machine, as an earlier start has kept it where that can be trusted."""
    path = kept_at(program)
    code = None if path is None else _trusted(path)
    if code is not None:
        with contextlib.suppress(wasmtime.WasmtimeError):
            return wasmtime.Module.deserialize(engine, code)
    module = wasmtime.Module(engine, program)
    if path is not None:
        _keep(path, bytes(module.serialize()))
    return module


def kept_at(program: bytes) -> Path | None:
    """Return the file that a program's compiled form is kept in; None where none can be trusted."""
    if not hasattr(os, "geteuid"):
        return None
    base = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if not base.is_absolute():
        try:
            base = Path.home() / ("Library/Caches" if sys.platform == "darwin" else ".cache")
        except RuntimeError:
            return None  # a user without a home
    return base / "skincal" / "solver" / f"{sys.platform}-{os.uname().machine}-{hashlib.sha256(program).hexdigest()}"


def _trusted(path: Path) -> bytes | None:
    """Return what is kept in a file, without its checksum; None where another may have written it, or it is not whole."""
    try:
        folder = path.parent.lstat()
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW)
        with os.fdopen(descriptor, "rb") as file:
            about = os.fstat(descriptor)
            if not (stat.S_ISDIR(folder.st_mode) and stat.S_ISREG(about.st_mode) and _mine(folder) and _mine(about)):
                return None
            data = file.read()
    except OSError:
        return None
    return data[_SUM:] if hashlib.sha256(data[_SUM:]).digest() == data[:_SUM] else None


def _mine(about: os.stat_result) -> bool:
    return about.st_uid == os.geteuid() and not about.st_mode & OTHERS_WRITE


def _keep(path: Path, code: bytes) -> None:
    """Keep what was compiled; where that cannot be, the next start compiles again."""
    with contextlib.suppress(OSError):
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        # Readable by this user alone; in place only when it is whole.
        descriptor, name = tempfile.mkstemp(dir=path.parent)
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(hashlib.sha256(code).digest() + code)
            Path(name).replace(path)
        except OSError:
            Path(name).unlink(missing_ok=True)

"""The folder of a new session, which a command takes away again where it recorded nothing into it."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Generator
from pathlib import Path

from skincal.errors import InputError


class KeptError(InputError):
    """A recording is at fault, but something was recorded, and stays."""


@contextlib.contextmanager
def new_folder(folder: Path) -> Generator[None]:
    """Let a session be made in `folder`; on an `InputError` take away what was made, unless it is a `KeptError`.

    The same command with its input put right then finds its folder free. What was there before stays.
    """
    from skincal.session.scene_copy import SCENE_FOLDER

    missing = [place for place in (folder, *folder.parents) if not place.exists()]
    taken = (folder / SCENE_FOLDER).exists() or any(folder.glob("segment-*.mcap*"))
    try:
        yield
    except KeptError:
        raise
    except InputError:
        if not taken:
            shutil.rmtree(folder / SCENE_FOLDER, ignore_errors=True)
            for segment in folder.glob("segment-*.mcap*"):
                segment.unlink()
        for place in missing:
            # One that is not empty is in use by others.
            with contextlib.suppress(OSError):
                place.rmdir()
        raise

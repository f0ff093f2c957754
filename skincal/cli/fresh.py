"""The folder of a new session, which a command takes away again where it recorded nothing into it."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Generator
from pathlib import Path

from skincal.model.errors import InputError


class KeptError(InputError):
    """A recording is at fault, but something was recorded, and stays."""


class Fresh:
    """What became of the folder of a new session."""

    made = False
    """The session in it is this command's own: nobody else's is ever taken away."""


@contextlib.contextmanager
def new_folder(folder: Path) -> Generator[Fresh]:
    """Let a session be made in `folder`; on an `InputError` take away what was made, unless it is a `KeptError`.

    The same command with its input put right then finds its folder free. What was there before stays, and what another
    program makes there meanwhile.
    """
    from skincal.journal.scene_copy import SCENE_FOLDER

    missing = [place for place in (folder, *folder.parents) if not place.exists()]
    fresh = Fresh()
    try:
        yield fresh
    except KeptError:
        raise
    except InputError:
        if fresh.made:
            shutil.rmtree(folder / SCENE_FOLDER, ignore_errors=True)
            for segment in folder.glob("segment-*"):
                segment.unlink()
        for place in missing:
            # One that is not empty is in use by others.
            with contextlib.suppress(OSError):
                place.rmdir()
        raise

"""What tests have a process do; it imports this module, and nothing of Qt."""

from __future__ import annotations

import os
import signal
import time

from skincal.model.errors import InputError


def own_pid(_progress):
    return os.getpid()


def double(number, _progress):
    return 2 * number


def refuse(sentence, _progress):
    raise InputError(sentence)


def end_once(path, _progress):
    """End the process the first time, as where somebody kills it."""
    if not path.exists():
        path.touch()
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(60)
    return "the second time"


def end(_progress):
    os._exit(3)


def until_unwanted(path, progress):
    path.touch()
    while progress.is_wanted():
        time.sleep(0.001)
    return "unwanted"


def deaf_look(_files, _progress):
    """Look for ever, and ask nobody whether that is wanted."""
    time.sleep(60)


def deaf_import(request, _progress):
    """Begin a session, and hear nothing from then on."""
    request.folder.mkdir(parents=True)
    (request.folder / "segment-0001.mcap").touch()
    time.sleep(60)


def is_running(process: int | None) -> bool:
    """Whether there is a process of that number."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True

"""A session loaded from what was made of its bytes, played again from the bytes, or taken up where it stopped.

The contacts are the truth of a session, the bytes are their evidence. Both ways lead to the same session to the last bit, as
long as neither the scene nor the detector changed since.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from skincal.journal.documents import Ending, SegmentMark, Taken, Totals
from skincal.journal.lock import SessionLock
from skincal.journal.reader import LogItem, LogState, SessionLog, recover_session
from skincal.journal.writer import open_segment
from skincal.model.actions import FoundAtLandmark, Stamped
from skincal.model.errors import InputError
from skincal.model.scene import Scene, with_layout
from skincal.session.pipeline import Pipeline
from skincal.streams.links import LinkSpec

if TYPE_CHECKING:
    from skincal.mesh.surface import Surface

_MISFIT = "An action of the operator no longer fits and is left out"
MAX_PAUSE_S = 1.0
"""s. Longest pause of a replay at speed: between segments, and where a device was silent, nothing happens."""


def replay(
    folder: Path, speed: float | None = None, stop: Callable[[], bool] = lambda: False, layout: Path | None = None
) -> Pipeline:
    """Play a session again into a pipeline of its own; nothing in the folder changes.

    Parameters
    ----------
    folder : of the session
    speed : times real time; None as fast as it goes
    stop : asked after each item; true ends the replay early
    layout : file of a layout that takes the place of the scene's

    Returns
    -------
    The pipeline, with the estimates of the live session to the last bit, and `findings` on damage.

    Raises
    ------
    InputError
        The folder is not a session, or its scene or mesh cannot be read.
    """
    return _played(SessionLog(folder), layout, speed, stop)


def load(folder: Path, layout: Path | None = None) -> Pipeline:
    """Return a session as it was taken, without playing its bytes; nothing in the folder changes.

    Where the bytes must be played after all, they are: the session is older than the notes, or its scene was changed since.

    Parameters
    ----------
    layout : file of a layout that takes the place of the scene's; pokes are as they were judged with that one

    Returns
    -------
    The pipeline, with the estimates of the live session to the last bit; `findings` on damage. A streamed arm pose is unknown
    until joints are streamed again.

    Raises
    ------
    InputError
        As for `replay`.
    """
    return _load(SessionLog(folder), layout)


def _load(log: SessionLog, layout: Path | None = None) -> Pipeline:
    if log.scene_changed or not log.has_notes:
        return _played(log, layout)
    pipeline = _new_pipeline(log, layout)
    misfits: list[str] = []
    for item in log.state():
        if log.scene_changed or not log.has_notes:
            return _played(SessionLog(log.folder, own=log.own), layout)
        try:
            _load_step(pipeline, item)
        except InputError as error:
            misfits.append(f"{_MISFIT}: {error}")
    pipeline.renew_detector()
    pipeline.findings = (*log.findings, *misfits)
    return pipeline


def _new_pipeline(log: SessionLog, layout: Path | None) -> Pipeline:
    """Return an empty pipeline for a session, with the layout of a file where one is given."""
    scene = log.scene if layout is None else with_layout(log.scene, layout)
    return Pipeline(scene, log.links, _surface(scene))


def _load_step(pipeline: Pipeline, item: LogState) -> None:
    if isinstance(item, SegmentMark):
        if item.number > 1:
            pipeline.begin_segment(item.links)
    elif isinstance(item, Stamped):
        pipeline.session.act(item.action)
    elif isinstance(item, Taken | Totals):
        pipeline.take(item)


def resume(folder: Path, links: Sequence[LinkSpec] | None = None) -> Pipeline:
    """Take a session up where it stopped: recovered if it was cut off, loaded, and open in a new segment.

    Parameters
    ----------
    links : where readings come from now; those of the last segment if None

    Raises
    ------
    InputError
        As for `replay`; also if the folder cannot be written, or is being written by another process.
    """
    SessionLog(folder)  # says what is wrong before anything is changed
    lock = SessionLock(folder)
    try:
        return _resume(folder, links, lock)
    except BaseException:
        lock.release()
        raise


def _resume(folder: Path, links: Sequence[LinkSpec] | None, lock: SessionLock) -> Pipeline:
    said = recover_session(folder)
    pipeline = _load(SessionLog(folder, own=True))
    links = pipeline.links if links is None else tuple(links)
    pipeline.begin_segment(links, open_segment(folder, pipeline.scene, links, lock))
    pipeline.findings = (*said, *pipeline.findings)
    return pipeline


def step(pipeline: Pipeline, item: LogItem) -> None:
    """Do one item of a log on a pipeline."""
    if isinstance(item, SegmentMark):
        if item.number > 1:
            pipeline.begin_segment(item.links)
    elif isinstance(item, Stamped):
        # The bytes and what was asked for lead to these again.
        if not isinstance(item.action, FoundAtLandmark):
            pipeline.act(item.action, item.host_ns)
    elif isinstance(item, Ending):
        pipeline.put_down(item.host_ns)
    else:
        pipeline.feed(item)


def _played(
    log: SessionLog, layout: Path | None, speed: float | None = None, stop: Callable[[], bool] = lambda: False
) -> Pipeline:
    pipeline = _new_pipeline(log, layout)
    pace = None if speed is None else _Pace(speed)
    misfits: list[str] = []
    for item in log.items():
        if pace is not None:
            pace.wait(item.host_ns)
        try:
            step(pipeline, item)
        except InputError as error:
            if not isinstance(item, Stamped):
                raise
            # Thresholds of the scene that were changed since may have made another thing of a poke.
            misfits.append(f"{_MISFIT}: {error}")
        if stop():
            break
    pipeline.findings = (*log.findings, *misfits)
    return pipeline


class _Pace:
    """Waits until an item is due."""

    def __init__(self, speed: float) -> None:
        self._speed = speed
        self._due_s = time.monotonic()
        self._last_ns: int | None = None

    def wait(self, host_ns: int) -> None:
        if self._last_ns is not None:
            passed_s = max(0.0, (host_ns - self._last_ns) * 1e-9)
            self._due_s += min(passed_s, MAX_PAUSE_S) / self._speed
        self._last_ns = host_ns
        ahead_s = self._due_s - time.monotonic()
        if ahead_s > 0:
            time.sleep(ahead_s)


def _surface(scene: Scene) -> Surface | None:
    if scene.surface is None:
        return None
    from skincal.mesh.load import load_surface

    return load_surface(scene.surface)[0]

"""Loading a session from its stored pokes, replaying it from its bytes, or resuming it.

Loading is fast, replaying starts from the raw bytes. Both give the same session to the last bit, as long as neither the scene
nor the detector has changed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from itertools import groupby, islice
from pathlib import Path

from skincal.journal.documents import (
    FIRST_FORMAT_WITH_GROUPED_POSES,
    FIRST_FORMAT_WITH_WRENCH_FRAMES,
    DetectorResult,
    SegmentHeader,
    SessionClosed,
    Totals,
)
from skincal.journal.lock import SessionLock
from skincal.journal.reader import LogItem, LogState, SessionLog, recover_session
from skincal.journal.writer import open_segment
from skincal.model.actions import FoundAtLandmark, MissedLandmark, TimedAction
from skincal.model.errors import InputError
from skincal.model.readings import Chunk, LinkEvent
from skincal.model.scene import ships, with_layout
from skincal.part.part import load_scene_surface
from skincal.session.pipeline import Pipeline
from skincal.streams.links import ITEMS_AT_ONCE, LinkSpec

_ACTION_MISFIT = "An action of the operator no longer fits and is left out"


def replay(folder: Path, layout: Path | None = None) -> Pipeline:
    """Replay a session into a new pipeline; nothing in the folder changes.

    The pipeline has the estimates of the live session to the last bit, and `findings` on damage. `layout` is the file of a
    layout to use in place of the scene's.

    Raises
    ------
    InputError
        The folder is not a session, or its scene or mesh cannot be read.
    """
    return _played(SessionLog(folder), layout)


def load(folder: Path, layout: Path | None = None) -> Pipeline:
    """Load a session from its stored pokes; nothing in the folder changes.

    It is replayed if its scene has changed, or if a line file is missing or damaged. Else as `replay`, but with another layout
    pokes stay as they were judged with the scene's, and a streamed arm pose is unknown until joints are streamed again.
    """
    return _load(SessionLog(folder), layout)


def _load(log: SessionLog, layout: Path | None = None) -> Pipeline:
    pipeline = _new_pipeline(log, layout)
    misfits: list[str] = []
    for item in log.state():
        if log.scene_changed:
            break
        try:
            _load_step(pipeline, item)
        except InputError as error:
            misfits.append(f"{_ACTION_MISFIT}: {error}")
    # Results hold for the scene of their recording only, and a segment with a damaged line file has none.
    if log.scene_changed or not log.has_results:
        return _played(SessionLog(log.folder, own=log.own), layout)
    pipeline.renew_detector()
    pipeline.findings = (*log.findings, *misfits)
    return pipeline


def _new_pipeline(log: SessionLog, layout: Path | None) -> Pipeline:
    scene = log.scene if layout is None else with_layout(log.scene, layout)
    return Pipeline(scene, log.links, load_scene_surface(scene)[0])


def _load_step(pipeline: Pipeline, item: LogState) -> None:
    if isinstance(item, TimedAction):
        # Not the pipeline's `act`: the following notes hold the detector's reaction.
        pipeline.session.act(item.action, item.host_ns * 1e-9)
        pipeline.note_skipped_pose(item.action)
    elif isinstance(item, DetectorResult | Totals):
        pipeline.apply_note(item)
    elif isinstance(item, SegmentHeader):
        apply_item(pipeline, item)


def resume(folder: Path, links: Sequence[LinkSpec] | None = None) -> Pipeline:
    """Resume a session: recover it if it was cut off, load it, and open a new segment.

    Without `links` readings come from those of the last segment.

    Raises
    ------
    InputError
        As for `replay`; also if the folder cannot be written, ships with skincal, or is being written by another process.
    """
    if ships(folder):
        raise InputError(f"{folder}: ships with skincal and is not changed; copy the folder and continue with the copy.")
    SessionLog(folder)  # refuses before anything is changed
    lock = SessionLock(folder)
    with ExitStack() as at_failure:
        at_failure.callback(lock.release)
        said = recover_session(folder)
        pipeline = _load(SessionLog(folder, own=True))
        links = pipeline.links if links is None else tuple(links)
        pipeline.begin_segment(links, open_segment(folder, pipeline.scene, links, lock))
        pipeline.findings = (*said, *pipeline.findings)
        at_failure.pop_all()
    return pipeline


def apply_item(pipeline: Pipeline, item: LogItem) -> None:
    """Apply one item of a log to a pipeline."""
    if isinstance(item, SegmentHeader):
        if item.number > 1:
            pipeline.begin_segment(item.links)
        pipeline.finds_skin_unit = False
        pipeline.poses.are_grouped = item.format >= FIRST_FORMAT_WITH_GROUPED_POSES
        pipeline.reads_frames = item.format >= FIRST_FORMAT_WITH_WRENCH_FRAMES
        pipeline.session.set_clock(item.clock)
    elif isinstance(item, TimedAction):
        # These follow again from bytes and requests.
        if not isinstance(item.action, FoundAtLandmark | MissedLandmark):
            pipeline.act(item.action, item.host_ns)
    elif isinstance(item, SessionClosed):
        pipeline.end_session(item.host_ns)
    else:
        pipeline.feed(item)


def _feed(pipeline: Pipeline, items: Iterator[LogItem]) -> None:
    """Feed chunks and events, many at a time."""
    from_links = (item for item in items if isinstance(item, Chunk | LinkEvent))
    while block := list(islice(from_links, ITEMS_AT_ONCE)):
        pipeline.feed_many(block)


def _played(log: SessionLog, layout: Path | None) -> Pipeline:
    pipeline = _new_pipeline(log, layout)
    misfits: list[str] = []
    for are_from_links, run in groupby(log.items(), lambda item: isinstance(item, Chunk | LinkEvent)):
        if are_from_links:
            _feed(pipeline, run)
            continue
        for item in run:
            try:
                apply_item(pipeline, item)
            except InputError as error:
                if not isinstance(item, TimedAction):
                    raise
                # With changed thresholds of the scene a poke may have another outcome.
                misfits.append(f"{_ACTION_MISFIT}: {error}")
    pipeline.findings = (*log.findings, *misfits)
    return pipeline

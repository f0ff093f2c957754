"""Builders that tests share: outcomes, sessions, and recorded folders."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np

from skincal.contacts.outcome import Outcome, Reason, Rejection
from skincal.journal.documents import DetectorResult
from skincal.journal.writer import create_session
from skincal.mesh.surface import Surface
from skincal.model.actions import Action, AtLandmark
from skincal.model.readings import Chunk, LinkEvent
from skincal.model.scene import Scene
from skincal.pokes import NO_LANDMARK_POKES, LandmarkPokes
from skincal.session.pipeline import Pipeline
from skincal.session.session import Session
from skincal.streams.links import LinkSpec
from tests.skincal.poke_script import LINKS, small_scene

NO_CHANNELS = np.empty(0, dtype=np.int64)


def rejection(poke: int, reason: Reason = Reason.SLID) -> Rejection:
    """A final rejection without a force."""
    return Rejection(poke, 0.0, 1.0, reason, 1.0, 0.5, "", NO_CHANNELS, final=True)


def landmark_outcome(poke: LandmarkPokes) -> Rejection:
    """One poke at a landmark as the detector gives it: no taxel answered."""
    where = poke.force, poke.moment, poke.link_from_sensor, str(poke.pose)
    return Rejection(int(poke.number), 0.0, 0.3, Reason.NO_TAXEL, 0.0, 1.0, "", NO_CHANNELS, True, *where)


def session_of(
    outcomes: Iterable[Outcome] = (),
    scene: Scene | None = None,
    surface: Surface | None = None,
    landmarks: LandmarkPokes = NO_LANDMARK_POKES,
) -> Session:
    """A session with these pokes and landmark pokes."""
    session = Session(scene or small_scene(), surface)
    for outcome in outcomes:
        session.add(outcome)
    for poke in landmarks:
        session.add(landmark_outcome(poke))
        session.act(AtLandmark(int(poke.number), str(poke.name)))
    return session


def feed(pipeline: Pipeline, items: Sequence[Chunk | LinkEvent], actions: Iterable[tuple[float, Action]] = ()) -> Pipeline:
    """Give a pipeline items; an action is done after the item with its index, or at its share of all items below 1."""
    due = [(round(at * len(items)) if at < 1 else at, action) for at, action in actions]
    for k, item in enumerate(items):
        pipeline.feed(item)
        for at, action in due:
            if at == k:
                pipeline.act(action, item.host_ns)
    return pipeline


def noted_session(folder: Path, scene: Scene, surface: Surface | None, outcomes: Sequence[Outcome]) -> Pipeline:
    """A recorded session, still open, whose pokes are written as a detector's, without bytes: opened without a replay."""
    pipeline, taken = Pipeline(scene, LINKS, surface, create_session(folder, scene, LINKS)), DetectorResult(list(outcomes))
    pipeline.apply_note(taken)
    pipeline.journal.write(Chunk("wrench", 1, b""), [taken])
    return pipeline


def recording(
    scene: Scene,
    folder: Path,
    items: Sequence[Chunk | LinkEvent],
    actions: Iterable[tuple[float, Action]] = (),
    links: Sequence[LinkSpec] = LINKS,
    change: Callable[[Sequence[Chunk | LinkEvent]], Sequence[Chunk | LinkEvent]] = lambda items: items,
) -> Pipeline:
    """A session that is recorded into a folder, still open."""
    return feed(Pipeline(scene, links, None, create_session(folder, scene, links)), change(items), actions)

"""A simulated session in virtual time: device bytes through the pipeline into a journal."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from skincal.files.atomic import write_atomically
from skincal.files.reference import TRUTH_NAME
from skincal.journal.writer import create_session
from skincal.mesh.surface import Surface
from skincal.model.errors import InputError
from skincal.model.readings import SESSION_START_TIME_NS, Chunk, LinkEvent, LinkState, Tick
from skincal.model.scene import Scene
from skincal.session.pipeline import Pipeline
from skincal.simulation.device import DeviceSettings, DeviceTimeline
from skincal.simulation.operator import AutoOperator, Habits
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.rig_of_scene import make_rig
from skincal.streams.links import SIMULATED_ADDRESS, LinkSpec

BLOCKS_AT_ONCE = 100
"""Blocks of readings that are computed and decoded together: one second."""
MIN_SESSION_DURATION_S = 1.0
"""s, minimum length of a session that is ended early, so that each link has data."""


def simulate_session(
    scene: Scene,
    surface: Surface | None,
    folder: Path,
    pokes: int,
    seed: int,
    errors: RigErrors,
    *,
    poses: Sequence[str] = (),
    channels: Sequence[int] | None = None,
    habits: Habits | None = None,
    settings: DeviceSettings | None = None,
    progress: Callable[[int], None] | None = None,
    go_on: Callable[[], bool] = lambda: True,
    seen_as: Scene | None = None,
) -> Pipeline:
    """Record a session of pokes on a simulated rig. Return its pipeline; the journal is closed.

    Parameters
    ----------
    folder : of the new session; `truth.json` is written there too
    pokes, poses, channels : as for `AutoOperator`
    seed : equal seeds give equal bytes
    progress : called with the new number of begun pokes
    go_on : the session ends early when it returns False
    seen_as : scene of the session if it differs from that of the rig: mistakes are made so

    Raises
    ------
    InputError
        The scene has no taxel positions, a pose is unknown, or the folder cannot be used.
    """
    # Separate random streams: another operator gets the same rig and devices.
    rng = np.random.default_rng(seed)
    rig_rng, operator_rng, device_rng = rng.spawn(3)
    rig = make_rig(scene, surface, errors, rig_rng)
    usual = Habits() if rig.tool is None else Habits().with_tool()
    operator = AutoOperator(rig, habits or usual, operator_rng, pokes, poses, channels)
    line = DeviceTimeline(rig, operator, device_rng, settings)
    links = [LinkSpec(name, f"{SIMULATED_ADDRESS}{name}", (stream,)) for name, stream in line.links.items()]
    seen = seen_as or scene
    pipeline = Pipeline(seen, links, surface, create_session(folder, seen, links))
    try:
        write_atomically(folder / TRUTH_NAME, json.dumps(rig.truth(), indent=1).encode() + b"\n")
    except InputError:
        pipeline.close()
        raise
    for link in links:
        pipeline.feed(LinkEvent(link.name, SESSION_START_TIME_NS, LinkState.OPEN))
    begun = 0
    while not line.finished:
        blocks = line.advance_many(BLOCKS_AT_ONCE)
        items: list[Chunk | LinkEvent | Tick] = []
        for end_s, arrived in blocks:
            items += [Chunk(link, SESSION_START_TIME_NS + at_ns, data) for at_ns, link, data in arrived]
            items.append(Tick(SESSION_START_TIME_NS + round(end_s * 1e9)))
        pipeline.feed_many(items)
        if progress is not None and operator.begun != begun:
            begun = operator.begun
            progress(begun)
        if line.now >= MIN_SESSION_DURATION_S and not go_on():
            break
    for link in links:
        pipeline.feed(LinkEvent(link.name, SESSION_START_TIME_NS + round(line.now * 1e9), LinkState.ENDED))
    pipeline.close()
    return pipeline

"""Sessions on disk for tests of the journal: recorded, damaged, compared."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

from mcap.opcode import Opcode

from skincal.journal.writer import create_session
from skincal.model.actions import Action
from skincal.model.scene import Scene
from skincal.session.pipeline import Pipeline
from tests.skincal.poke_script import LINKS, Script, as_chunks, outcome_key, same_estimates, some_pokes

ROOT = Path(__file__).resolve().parents[3]
ENVIRONMENT = os.environ | {"PYTHONPATH": str(ROOT)}
RECORDING = """
import sys
from pathlib import Path
from skincal.model.errors import InputError
from skincal.session.pipeline import Pipeline
from skincal.session.replay import replay, resume
from skincal.journal.writer import create_session
from tests.skincal.poke_script import LINKS, as_chunks, some_pokes, write_scene
folder = Path(sys.argv[1])
scene = write_scene(folder / "source")
"""
"""Beginning of a script for another process."""


def process(code: str, *words: object, imports: str = RECORDING, **options: object) -> subprocess.Popen[str]:
    """Start Python code in another process, its words in `sys.argv`."""
    command = [sys.executable, "-W", "error", "-c", imports + code, *map(str, words)]
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, env=ENVIRONMENT, **options)


def new_session(scene: Scene, folder: Path) -> Pipeline:
    return Pipeline(scene, LINKS, None, create_session(folder, scene, LINKS))


def record(
    scene: Scene, folder: Path, script: Script | int = 4, actions: Iterable[tuple[float, Action]] = (), seed: int = 5
) -> Pipeline:
    """Record a script, or so many pokes; each action comes at its share of the items. The session stays open."""
    return feed(new_session(scene, folder), some_pokes(scene, script, seed) if isinstance(script, int) else script, actions)


def feed(pipeline: Pipeline, script: Script, actions: Iterable[tuple[float, Action]] = ()) -> Pipeline:
    items = as_chunks(script.samples)
    due = {round(share * len(items)): action for share, action in actions}
    for k, item in enumerate(items):
        pipeline.feed(item)
        if k in due:
            pipeline.act(due[k], item.host_ns)
    return pipeline


def more_pokes(pipeline: Pipeline, count: int = 1, seed: int = 9) -> Pipeline:
    return feed(pipeline, some_pokes(pipeline.scene, count, seed))


def segment(folder: Path, number: int = 1) -> Path:
    return folder / f"segment-{number:04d}.mcap"


def contacts_of(pipeline: Pipeline) -> list[tuple[object, ...]]:
    return [outcome_key(contact) for contact in pipeline.session.contacts]


def outcomes_of(pipeline: Pipeline) -> list[tuple[object, ...]]:
    return [outcome_key(poke.outcome) for poke in pipeline.snapshot().pokes]


def assert_same(*pipelines: Pipeline) -> None:
    """Every number of the sessions is the same, to the last bit."""
    first, *others = (pipeline.snapshot() for pipeline in pipelines)
    for pipeline, other in zip(pipelines[1:], others, strict=True):
        assert outcomes_of(pipelines[0]) == outcomes_of(pipeline)
        assert [poke.excluded for poke in first.pokes] == [poke.excluded for poke in other.pokes]
        assert list(first.dead.items()) == list(other.dead.items())
        assert first.can_undo == other.can_undo
        assert same_estimates(first, other)
    assert len({(pipeline.session.decisions.pose, pipeline.session.channels) for pipeline in pipelines}) == 1


def records_of(data: bytes, kind: Opcode) -> Iterator[tuple[int, int]]:
    """Yield begin and end of each record of a kind in an MCAP file."""
    at = 8
    while at < len(data) - 8:
        end = at + 9 + int.from_bytes(data[at + 1 : at + 9], "little")
        if data[at] == kind:
            yield at, end
        at = end


def files_of(folder: Path) -> dict[Path, bytes]:
    return {path.relative_to(folder): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def refuse(*_: object, **__: object) -> None:
    """Stands for a function of the system when the disk is full."""
    raise OSError(28, "No space left on device")

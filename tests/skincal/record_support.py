"""`skincal record` in a process of its own, on files played at the pace of their devices; or here, on a rig that is told."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import pytest

from skincal.contacts.outcome import PressPhase
from skincal.model.readings import Chunk
from skincal.session.pipeline import Pipeline
from tests.skincal.poke_script import as_chunks, some_pokes, write_scene


def write_devices(folder: Path, pokes: int, seed: int = 5) -> list[str]:
    """Write a scene and what its devices send; return the options that name them."""
    scene = write_scene(folder / "source")
    items = [item for item in as_chunks(some_pokes(scene, pokes, seed).samples) if isinstance(item, Chunk)]
    for name in ("wrench", "skin"):
        (folder / f"{name}.bin").write_bytes(b"".join(item.data for item in items if item.link == name))
    return [
        *("--wrench", f"file:{folder / 'wrench.bin'}", "--skin", f"file:{folder / 'skin.bin'}"),
        *("--scene", str(folder / "source" / "patch.toml")),
    ]


def recorder(options: list[str], out: Path, **more) -> subprocess.Popen[str]:
    """Start a recording; pokes and links come line by line on stderr, the result at the end on stdout."""
    command = [sys.executable, "-P", "-m", "skincal.cli", "record", *options, "--out", str(out)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **more)


@contextmanager
def told_to_poke(server: subprocess.Popen[str], *pokes: str, accepted: int) -> Generator[None]:
    """Order pokes of a served rig as soon as a recording in this process can measure them: an earlier poke would be lost.

    The recording is stopped, as by Ctrl-C, when so many are accepted: on a busy machine some of them are not.
    """
    tick, waiting = Pipeline.tick, [f"poke {each}\n" for each in pokes]

    def tick_and_order(pipeline: Pipeline, now_ns: int) -> None:
        tick(pipeline, now_ns)
        if waiting and pipeline.phase is PressPhase.READY and pipeline.can_measure(now_ns):
            assert server.stdin is not None
            server.stdin.write("".join(waiting))
            server.stdin.flush()
            waiting.clear()
        elif sum(contact.final for contact in pipeline.session.contacts) >= accepted:
            signal.raise_signal(signal.SIGINT)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Pipeline, "tick", tick_and_order)
        yield

"""`skincal record` as a process of its own, on files that are played at the pace of their devices: a poke a second."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from skincal.model.readings import Chunk
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

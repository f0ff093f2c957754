"""A bench with a board as people solder it: a grid of taxels on a table-mounted sensor, and its faults, from a seed.

The tip pushes a point of the flat skin with a known force; a taxel at distance d answers with gain * force * exp(-d / reach).
The table is what such a rig logs: one row a frame with the time, the wrench and all channels. Truth is the grid itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from skincal.cli import main
from skincal.geometry import FloatArray
from skincal.session.replay import load
from skincal.session.snapshot import Snapshot
from skincal.taxels.result import Method

RATE_HZ = 50.0


@dataclass(frozen=True)
class Board:
    """A grid of taxels in the plane z = 0 of its link, the sensor below it, and how it is poked."""

    rows: int = 8
    columns: int = 8
    pitch: float = 0.008
    reach: float = 0.0025
    """m, distance over which an answer falls to 1/e."""
    gain: float = 50.0
    """Counts a newton."""
    forces: tuple[float, float] = (6.0, 11.0)
    rest: tuple[float, float] = (100.0, 130.0)
    """Counts, smallest and largest value of a taxel without a touch."""
    noise: float = 1.0
    """Counts."""
    pokes_each: int = 3
    """Pokes on each taxel."""
    aim_sd: float = 0.0005
    tilt_deg: float = 25.0
    depth: float = 0.040
    """m, from the sensor's origin to the skin."""
    force_noise: float = 0.03
    moment_noise: float = 0.0005

    @property
    def channels(self) -> int:
        return self.rows * self.columns

    @property
    def places(self) -> FloatArray:
        """(channels, 3) float, metres: truth."""
        row, column = np.divmod(np.arange(self.channels), self.columns)
        middle = np.array([(self.columns - 1) / 2, (self.rows - 1) / 2])
        flat = (np.stack([column, row], axis=1) - middle) * self.pitch
        return np.column_stack([flat, np.zeros(self.channels)])


@dataclass(frozen=True, eq=False)
class Frames:
    """A log: n frames of the rig, and what the skin would send if nothing was wrong."""

    board: Board
    times: FloatArray
    wrench: FloatArray
    """(n, 6) with noise, sensor frame."""
    rest: FloatArray
    """(channels,)"""
    answers: FloatArray
    """(n, channels) counts above rest, without noise."""
    noise: FloatArray
    """(n, channels) counts."""

    @property
    def plain(self) -> FloatArray:
        """(n, channels) counts of a board without a fault."""
        return np.round(self.rest + self.answers + self.noise)

    @property
    def ghosts(self) -> FloatArray:
        """(n, channels) counts: the strongest answer in the row or column of each taxel."""
        grid = self.answers.reshape(-1, self.board.rows, self.board.columns)
        strongest = np.maximum(grid.max(axis=2, keepdims=True), grid.max(axis=1, keepdims=True))
        return strongest.reshape(len(grid), -1)


def poke(board: Board, seed: int = 1, targets: Sequence[int] | None = None) -> Frames:
    """Poke every taxel, or the `targets` in their order, by hand: rest, rise, hold, fall, rest."""
    rng = np.random.default_rng(seed)
    if targets is None:
        targets = rng.permutation(np.repeat(np.arange(board.channels), board.pokes_each)).tolist()
    gains = board.gain * rng.uniform(0.85, 1.15, board.channels)
    rest = rng.uniform(*board.rest, board.channels)
    shape = np.concatenate([np.zeros(35), np.linspace(0, 1, 8), np.ones(32), np.linspace(1, 0, 6)])
    wrench, answers = [], []
    for target in targets:
        at = board.places[target] + np.array([*rng.normal(0.0, board.aim_sd, 2), 0.0])
        turn, lean = rng.uniform(0, 2 * np.pi), np.radians(board.tilt_deg) * np.sqrt(rng.uniform(0.1, 1.0))
        push = np.array([np.sin(lean) * np.cos(turn), np.sin(lean) * np.sin(turn), -np.cos(lean)])
        force = rng.uniform(*board.forces) * push
        lever = at + np.array([0.0, 0.0, board.depth])
        wrench.append(shape[:, None] * np.concatenate([force, np.cross(lever, force)]))
        away = np.linalg.norm((board.places - at)[:, :2], axis=1)
        answers.append(shape[:, None] * np.linalg.norm(force) * gains * np.exp(-away / board.reach))
    count = len(targets) * len(shape)
    drift = np.cumsum(rng.normal(0, [0.0005] * 3 + [2e-6] * 3, (count, 6)), axis=0)
    spread = np.array([board.force_noise] * 3 + [board.moment_noise] * 3)
    return Frames(
        board,
        np.arange(count) / RATE_HZ,
        np.concatenate(wrench) + drift + rng.normal(0, spread, (count, 6)),
        rest,
        np.concatenate(answers),
        rng.normal(0, board.noise, (count, board.channels)) if board.noise else np.zeros((count, board.channels)),
    )


def scene_text(board: Board, *, layout: bool = False, mesh: bool = True, skin: str = "", more: str = "") -> str:
    """Write the scene of the bench; `skin` is added to [skin], `more` to the end."""
    surface = '[surface]\nmesh = "plate.obj"\nunit = "m"\n' if mesh else ""
    modules = 'modules = "modules.toml"\n' if layout else ""
    middle = [(board.columns - 1) / 2 * board.pitch * 1e3, (board.rows - 1) / 2 * board.pitch * 1e3]
    anchor = f"[skin.anchor]\nat_mm = {middle}\npoint_mm = [0, 0, 0]\nx = [1, 0, 0]\nnormal = [0, 0, 1]\n" if layout else ""
    return (
        f'name = "bench"\nlink = "plate"\n[skin]\nchannels = {board.channels}\n{modules}{skin}{anchor}'
        f"[sensor]\npose = [[1,0,0,0],[0,1,0,0],[0,0,1,{-board.depth}],[0,0,0,1]]\n{surface}{more}"
    )


def layout_text(board: Board, order: Sequence[int] | None = None, blocks: int = 1) -> str:
    """Write a layout of one module for each of `blocks` groups of channels; pad k is taxel `order[k]`."""
    order = range(board.channels) if order is None else order
    pads = [[round(float(x), 6) for x in board.places[at, :2] * 1e3 - board.places[0, :2] * 1e3] for at in order]
    size, text = board.channels // blocks, ""
    for block in range(blocks):
        own = np.array(pads[block * size : (block + 1) * size])
        lines = ",\n".join(str(pad) for pad in (own - own[0]).round(6).tolist())
        low, high = (own - own[0]).min(axis=0) - 2, (own - own[0]).max(axis=0) + 2
        corners = [[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]]
        outline = [[float(x), float(y)] for x, y in corners]
        text += f"[kinds.part{block}]\ncentre_pad = 0\noutline_mm = {outline}\npads_mm = [\n{lines},\n]\n"
    for block in range(blocks):
        at = f"first_channel = {block * size}\nplace_mm = {pads[block * size]}\n"
        text += f'[[modules]]\nid = {block}\nkind = "part{block}"\n{at}'
    return text


def write_table(path: Path, frames: Frames, values: FloatArray, *, names: str = "t") -> Path:
    """Write one table with time, wrench and all channels."""
    head = ",".join(["time", "fx", "fy", "fz", "mx", "my", "mz", *(f"{names}{k}" for k in range(values.shape[1]))])
    rows = (
        ",".join([f"{time:.3f}", *(f"{w:.6f}" for w in wrench), *(f"{v:.8g}" for v in skin)])
        for time, wrench, skin in zip(frames.times, frames.wrench, values, strict=True)
    )
    path.write_text("\n".join([head, *rows]) + "\n")
    return path


def write_rig(folder: Path, frames: Frames, values: FloatArray, file: str = "", **scene: Any) -> tuple[Path, Path]:
    """Write scene, layout (the text `file`, or the board's) and table into a folder; return scene and table."""
    folder.mkdir(parents=True, exist_ok=True)
    place = folder / "scene.toml"
    place.write_text(scene_text(frames.board, **scene))
    size = float(np.abs(frames.board.places).max()) + 0.02
    corners = [(-size, -size), (size, -size), (size, size), (-size, size)]
    (folder / "plate.obj").write_text("".join(f"v {x} {y} 0\n" for x, y in corners) + "f 1 2 3\nf 1 3 4\n")
    if scene.get("layout"):
        (folder / "modules.toml").write_text(file or layout_text(frames.board))
    return place, write_table(folder / "log.csv", frames, values)


def import_board(folder: Path, frames: Frames, values: FloatArray, **scene: Any) -> Snapshot:
    """Import the log by the command, and load its session from the disk."""
    place, table = write_rig(folder, frames, values, **scene)
    arguments = ["--wrench", str(table), "--skin", str(table), "--scene", str(place), "--out", str(folder / "s")]
    assert main(["import", "csv", *arguments]) == 0
    return load(folder / "s").snapshot()


def errors(snapshot: Snapshot, board: Board, method: Method = Method.SURFACE) -> FloatArray:
    """List (n, 2) metres, of the estimated taxels: distance from the truth, and expected error."""
    known = [each for each in snapshot.estimates[method] if each.position is not None]
    off = [np.linalg.norm(each.position - board.places[each.channel]) for each in known]
    return np.column_stack([off, [each.rms for each in known]])

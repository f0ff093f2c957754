"""Recordings of other programs, written from scripted samples."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from skincal.files.importers.registry import RECORDING_IMPORTERS, RecordedPlace
from skincal.model.readings import Chunk, Sample, Stream
from skincal.streams.links import LinkSpec

EPOCH = 1_420_000_000.0


def read_recording(
    kind: str, wrench: Path, skin: Path, joints: Path | None = None
) -> tuple[tuple[LinkSpec, ...], Iterator[Chunk], tuple[str, ...]]:
    """Links, chunks and findings of a recording."""
    importer = next(each for each in RECORDING_IMPORTERS if each.name == kind)
    places = {Stream.WRENCH: wrench, Stream.SKIN: skin, Stream.JOINTS: joints}
    opened = importer.open_recording({stream: RecordedPlace(path) for stream, path in places.items() if path is not None})
    return opened.links, opened.chunks(), opened.findings


def write_log(folder: Path, times: Sequence[float], rows: Sequence[np.ndarray]) -> Path:
    """A port's folder, as yarpdatadumper writes it."""
    folder.mkdir(parents=True)
    (folder / "info.log").write_text("Type: Bottle;\nStamp: rx;\n")
    lines = (
        f"{k} {EPOCH + time:.6f} {' '.join(f'{v:.7g}' for v in row)}\n"
        for k, (time, row) in enumerate(zip(times, rows, strict=True))
    )
    (folder / "data.log").write_text("".join(lines))
    return folder


def write_yarp(folder: Path, samples: Sequence[Sample], per_frame: int = 4, *, joints: int = 0) -> Path:
    """A recording with a skin frame each sample and `per_frame` wrenches in the time before it."""
    frames = [sample.host_s for sample in samples]
    step = (frames[1] - frames[0]) / per_frame
    fine = [time - step * k for time in frames for k in reversed(range(per_frame))]
    write_log(folder / "left_ft", fine, [sample.wrench for sample in samples for _ in range(per_frame)])
    write_log(folder / "left_forearm_skin", frames, [sample.skin for sample in samples])
    if joints:
        write_log(folder / "left_arm", frames[::5], [np.arange(joints) + 0.5] * len(frames[::5]))
    return folder


def write_csv(folder: Path, samples: Sequence[Sample]) -> Path:
    """Two tables with headers, named so that only their columns say what they are."""
    folder.mkdir(parents=True, exist_ok=True)
    width = len(samples[0].skin)
    for name, head, values in (
        ("a.csv", "t_s,fx,fy,fz,mx,my,mz", [sample.wrench for sample in samples]),
        ("b.csv", "t_s," + ",".join(f"c{k}" for k in range(width)), [sample.skin for sample in samples]),
    ):
        rows = (f"{s.host_s:.6f},{','.join(f'{v:.7g}' for v in row)}\n" for s, row in zip(samples, values, strict=True))
        (folder / name).write_text(f"{head}\n{''.join(rows)}")
    return folder

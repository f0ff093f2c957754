"""What a command lets its user wait for: the import of a log, and the help."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import skincal
from skincal.files.importers.yarp_folder import read_yarp
from skincal.geometry import FloatArray
from skincal.journal.writer import create_session
from skincal.model.readings import Batch, JointsBatch, SkinBatch, Stream
from skincal.session.pipeline import Pipeline
from skincal.simulate.benches import Bench
from skincal.simulate.device import DeviceTimeline
from skincal.simulate.faults import RigErrors
from skincal.simulate.operator import Auto, Habits
from skincal.simulate.simulated_rig import Rig
from skincal.streams.decoders.detect import LinkDecoder
from skincal.studies.measuring import quartiles, timed

EPOCH = 1_700_000_000.0
"""s since 1970 at which a made log begins; any will do."""
HELP = "from skincal.cli import main; main(['solve', '--help'])"
PROCESS = "import sys, time\nsys.path.append({folder!r})\n{work}\nprint('\\n', time.process_time(), sep='')\n"
"""Says at its end what processor time the whole process has taken, its start included."""


def import_time(bench: Bench, pokes: int) -> dict[str, Any]:
    """Time the import of a log of so many pokes: wrenches at 1 kHz, skin at 50 Hz, joints at 100 Hz, to a session on the disk.

    Returns
    -------
    JSON: `log_s`, how long the log is; `time_ms`; `words_ms`, which Python takes to make a number of each word of the log and
    nothing else
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        log_s = _write_log(bench, folder, pokes)
        places = [folder / stream.value for stream in (Stream.WRENCH, Stream.SKIN, Stream.JOINTS)]
        works = [lambda: _import(bench, places, folder / "session"), lambda: _read_words(places)]
        (whole, words), _ = timed(works)
    return {"log_s": log_s, "time_ms": 1e3 * whole, "words_ms": 1e3 * words}


def _write_log(bench: Bench, folder: Path, pokes: int) -> float:
    """Write what simulated devices send as folders of `yarpdatadumper`; return how many seconds of it there are."""
    rig = Rig(bench.scene, bench.surface, RigErrors.noise(), np.random.default_rng(1))
    operator = Auto(rig, Habits(), np.random.default_rng(2), pokes)
    line = DeviceTimeline(rig, operator, np.random.default_rng(3))
    decoders = {name: LinkDecoder("auto", bench.scene.skin.channels, (stream,)) for name, stream in line.links.items()}
    texts: dict[Stream, list[str]] = {stream: [] for stream in line.links.values()}
    begun: dict[Stream, float] = {}
    while not line.finished:
        for at_ns, link, data in line.step():
            stream = line.links[link]
            for _, batch in decoders[link].feed(data, at_ns):
                # Each device has a clock of its own; a log has the computer's.
                times = EPOCH + batch.device_s - begun.setdefault(stream, float(batch.device_s[0]))
                texts[stream] += _lines(len(texts[stream]), times, _values(batch))
    for stream, lines in texts.items():
        (folder / stream.value).mkdir()
        (folder / stream.value / "info.log").write_text("Type: Bottle;\nStamp: rx;\n", encoding="ascii")
        (folder / stream.value / "data.log").write_text("".join(lines), encoding="ascii")
    return line.now


def _values(batch: Batch) -> FloatArray:
    if isinstance(batch, JointsBatch):
        return np.degrees(batch.angles)
    return batch.values if isinstance(batch, SkinBatch) else batch.wrench


def _lines(first: int, times: FloatArray, values: FloatArray) -> list[str]:
    rows = enumerate(zip(times.tolist(), values.tolist(), strict=True), start=first)
    return [f"{number} {time:.6f} {' '.join(f'{value:.10g}' for value in row)}\n" for number, (time, row) in rows]


def _import(bench: Bench, places: list[Path], out: Path) -> None:
    links, chunks, _ = read_yarp(places[0], places[1], places[2])
    pipeline = Pipeline(bench.scene, links, bench.surface, create_session(out, bench.scene, links, copy=True))
    for chunk in pipeline.ahead(chunks):
        pipeline.feed(chunk)
        pipeline.tick(chunk.host_ns)
    pipeline.close()


def _read_words(places: list[Path]) -> None:
    for place in places:
        with (place / "data.log").open("rb") as file:
            for line in file:
                [float(word) for word in line.split()]


def help_time(repeats: int) -> dict[str, Any]:
    """Time `skincal solve --help` and a Python that does nothing, each a process: JSON, `time_ms` and `python_ms`."""
    works: dict[str, str] = {"time_ms": HELP, "python_ms": "pass"}
    return {name: quartiles([1e3 * _process_s(work) for _ in range(repeats)]) for name, work in works.items()}


def _process_s(work: str) -> float:
    script = PROCESS.format(folder=str(Path(skincal.__file__).parents[1]), work=work)
    done = subprocess.run([sys.executable, "-P", "-c", script], capture_output=True, text=True, check=True)
    return float(done.stdout.split()[-1])

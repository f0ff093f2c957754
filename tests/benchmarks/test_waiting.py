"""Limits on a developer's machine for start, import, memory and whole solves: `python3 -m pytest tests/benchmarks`."""

from __future__ import annotations

import copy
import subprocess
import sys
import time
import tracemalloc
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

import skincal
from skincal.journal.writer import create_session
from skincal.methods import estimate_taxels
from skincal.model.readings import Stream
from skincal.session.pipeline import Pipeline
from skincal.simulation.device import DeviceTimeline
from skincal.simulation.example_parts import ExamplePart
from skincal.simulation.operator import AutoOperator, Habits
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.simulated_rig import Rig
from skincal.streams.decoders.auto_detect import LinkDecoder
from skincal.streams.links import ITEMS_AT_ONCE
from skincal.studies.runtime import solved_session
from skincal.taxels.result import PER_TAXEL
from tests.skincal.import_support import read_recording

EPOCH_S = 1_700_000_000.0
"""When the log begins."""
LOG_POKES = 60
"""Some two seconds each."""


@pytest.fixture(scope="module")
def forearm():
    return ExamplePart("icub-forearm")


def test_the_help_comes_within_0_4_s():
    work = "from skincal.cli import main; main(['solve', '--help'])"
    root = Path(skincal.__file__).parents[1]
    script = f"import sys, time\nsys.path.append({str(root)!r})\n{work}\nprint('\\n', time.process_time(), sep='')\n"
    arguments = [sys.executable, "-P", "-c", script]
    seconds = [
        float(subprocess.run(arguments, capture_output=True, text=True, check=True).stdout.split()[-1]) for _ in range(5)
    ]
    assert np.median(seconds) <= 0.4


def test_ten_thousand_pokes_are_solved_within_2_s(benchmark, forearm):
    contacts = forearm.contacts(-(-10_000 // len(forearm.channels)), seed=3)[:10_000]
    arguments = (contacts, forearm.channels, PER_TAXEL, forearm.scene.noise, forearm.surface)
    assert len(benchmark.pedantic(estimate_taxels, arguments, rounds=3, warmup_rounds=1)) == 2
    assert benchmark.stats.stats.median <= 2.0


def test_a_thousand_more_pokes_take_2_mb(forearm):
    """A session of all the pokes less one of a quarter of them: what is loaded once is no poke's."""
    contacts = forearm.contacts(-(-4_000 // len(forearm.channels)), seed=4)[:4_000]
    solved_session(forearm, contacts[:1_000])
    taken = [
        traced_bytes(lambda some=some: solved_session(forearm, copy.deepcopy(some))) for some in (contacts[:1_000], contacts)
    ]
    assert (taken[1] - taken[0]) / 3.0 <= 2e6


def traced_bytes(make):
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        made = make()
        taken = tracemalloc.get_traced_memory()[0] - before
        del made
        return taken
    finally:
        tracemalloc.stop()


def test_an_import_costs_5_5_times_what_reading_its_numbers_does(forearm, tmp_path):
    """Wrenches at 1 kHz, skin of 384 channels at 50 Hz, joints at 100 Hz, to a session on the disk."""
    write_log(forearm, tmp_path)
    places = [tmp_path / stream.value for stream in (Stream.WRENCH, Stream.SKIN, Stream.JOINTS)]
    begin = time.process_time()
    links, chunks, _ = read_recording("yarp", *places)
    writer = create_session(tmp_path / "session", forearm.scene, links, copy=True)
    pipeline = Pipeline(forearm.scene, links, forearm.surface, writer)
    chunks = iter(chunks)
    while block := list(islice(chunks, ITEMS_AT_ONCE)):
        pipeline.feed_many(block)
    pipeline.close()
    imported = time.process_time()
    for place in places:
        with (place / "data.log").open("rb") as file:
            for line in file:
                [float(word) for word in line.split()]
    assert imported - begin <= 5.5 * (time.process_time() - imported)


def write_log(bench, folder):
    """Write what simulated devices send as folders of `yarpdatadumper`."""
    rig = Rig(bench.scene, bench.surface, RigErrors.noise(), np.random.default_rng(1))
    line = DeviceTimeline(rig, AutoOperator(rig, Habits(), np.random.default_rng(2), LOG_POKES), np.random.default_rng(3))
    decoders = {name: LinkDecoder("auto", bench.scene.skin.channels, (stream,)) for name, stream in line.links.items()}
    texts = {stream: [] for stream in line.links.values()}
    begun = {}
    while not line.finished:
        for at_ns, link, data in line.advance():
            stream = line.links[link]
            for _, batch in decoders[link].feed(data, at_ns):
                # Each device has a clock of its own; a log has the computer's.
                times = EPOCH_S + batch.device_s - begun.setdefault(stream, float(batch.device_s[0]))
                values = np.degrees(batch.values) if stream is Stream.JOINTS else batch.values
                rows = enumerate(zip(times.tolist(), values.tolist(), strict=True), start=len(texts[stream]))
                texts[stream] += [f"{n} {t:.6f} {' '.join(f'{value:.10g}' for value in row)}\n" for n, (t, row) in rows]
    for stream, lines in texts.items():
        (folder / stream.value).mkdir()
        (folder / stream.value / "info.log").write_text("Type: Bottle;\nStamp: rx;\n", encoding="ascii")
        (folder / stream.value / "data.log").write_text("".join(lines), encoding="ascii")

"""A robot's log of pokes becomes a calibration file whose positions are compared with the truth."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from skincal.contacts.outcome import Contact
from skincal.files.export import write_calibration
from skincal.files.icub import read_icub
from skincal.mesh.load import load_surface
from skincal.session.pipeline import Pipeline
from skincal.taxels.result import PER_TAXEL, Method
from tests.approved import approved
from tests.skincal.estimate_support import solve
from tests.skincal.files.files_support import CHANNELS, Part, make_part
from tests.skincal.files.json_reader import read_json
from tests.skincal.import_support import read_recording

EPOCH = 1_420_000_000.0
TAXELS = (0, 1, 2, 3)
PERIOD = 2.0
"""s from poke to poke: 0.7 s of quiet, 0.8 s pressed, 0.5 s of quiet."""
PUSHES = [(0.0, 0.0), (0.4, 0.0), (-0.4, 0.1), (0.0, 0.4), (0.1, -0.4), (0.3, 0.3)]

OFFSET = np.array([3.0, -7.0, 1.0, 0.1, 0.2, -0.3])
"""N and N m: the sensor's, which is unknown."""


def truth_at(part: Part, time: float) -> tuple[np.ndarray, np.ndarray]:
    """Wrench and skin of a rig that pokes each taxel from each side in turn."""
    poke, phase = divmod(time, PERIOD)
    channel = TAXELS[int(poke) // len(PUSHES) % len(TAXELS)]
    tilt = PUSHES[int(poke) % len(PUSHES)]
    normal = part.normals[channel]
    across = np.cross(normal, [0.0, 1.0, 0.0])
    push = -normal + tilt[0] * across + tilt[1] * np.array([0.0, 1.0, 0.0])
    level = np.clip(min(phase - 0.7, 1.5 - phase) / 0.1, 0.0, 1.0)
    force = level * 8.0 * push / np.linalg.norm(push)
    wrench = np.concatenate([force, np.cross(part.places[channel], force)]) + OFFSET
    skin = np.full(CHANNELS, 12.0)
    skin[channel] += 80 * level
    return wrench, skin


def write_logs(part: Part, folder: Path, skin_off: Callable[[float], float] = lambda _: 0.0) -> tuple[Path, Path]:
    """`skin_off` is by how much the clock of the skin's log is wrong, s, at a time, s."""
    rng = np.random.default_rng(3)
    seconds = PERIOD * len(PUSHES) * len(TAXELS)
    for name, rate, index, noise in (("wrench", 100, 0, 0.002), ("skin", 50, 1, 0.4)):
        (folder / name).mkdir()
        with (folder / name / "data.log").open("w") as file:
            for seq, time in enumerate(np.arange(int(seconds * rate)) / rate):
                values = truth_at(part, time)[index]
                scale = np.array([1, 1, 1, 0.05, 0.05, 0.05]) if index == 0 else 1.0
                noisy = values + noise * scale * rng.normal(size=len(values))
                stamp = EPOCH + time + (skin_off(time) if index else 0.0)
                file.write(f"{seq} {stamp:.6f} {' '.join(f'{value:.6f}' for value in noisy)}\n")
    return folder / "wrench", folder / "skin"


@pytest.fixture(scope="module")
def played(tmp_path_factory) -> tuple[Part, Pipeline]:
    part = make_part(tmp_path_factory.mktemp("part"))
    links, chunks, findings = read_recording("yarp", *write_logs(part, tmp_path_factory.mktemp("logs")))
    assert len(findings) == 2
    assert part.scene.surface is not None
    pipeline = Pipeline(part.scene, links, load_surface(part.scene.surface)[0])
    for chunk in chunks:
        pipeline.feed(chunk)
    pipeline.close()
    return part, pipeline


def test_every_poke_of_the_log_is_a_contact(played):
    _, pipeline = played
    outcomes = [record.outcome for record in pipeline.snapshot().pokes]
    assert len(outcomes) == len(PUSHES) * len(TAXELS)
    assert all(isinstance(outcome, Contact) for outcome in outcomes)


@pytest.mark.parametrize("off", [5.0, -5.0])
def test_a_clock_that_is_wrong_for_a_second_costs_no_poke(tmp_path, off):
    part = make_part(tmp_path / "part")
    links, chunks, _ = read_recording("yarp", *write_logs(part, tmp_path, lambda time: off * (6.1 <= time < 7.1)))
    pipeline = Pipeline(part.scene, links, None)
    for chunk in chunks:
        pipeline.feed(chunk)
    pipeline.close()
    outcomes = [record.outcome for record in pipeline.snapshot().pokes]
    assert sum(isinstance(outcome, Contact) for outcome in outcomes) == len(PUSHES) * len(TAXELS)


@pytest.mark.parametrize("method", PER_TAXEL)
def test_the_written_positions_are_the_true_ones(played, tmp_path, method):
    part, pipeline = played
    path = tmp_path / "positions.txt"
    said = write_calibration(pipeline.session.calibration(), "icub", path, method)
    rows = read_icub(path)
    assert np.flatnonzero(rows[:, :3].any(axis=1)).tolist() == list(TAXELS)
    for channel in TAXELS:
        assert np.linalg.norm(rows[channel, :3] - part.places[channel]) < 0.3e-3
        assert rows[channel, 3:] @ part.normals[channel] > np.cos(np.radians(12))
    left_out = approved("export.no_position", count=30, all=34, states="30 untouched")
    assert said == (f"{method.value}: {left_out}",)


def test_the_json_of_the_log_computes_again(played, tmp_path):

    _, pipeline = played
    calibration = pipeline.session.calibration()
    write_calibration(calibration, "json", tmp_path / "c.json", Method.FREE)
    file = read_json(tmp_path / "c.json")
    assert pipeline.session.surface is not None
    for method, estimates in calibration.estimates.items():
        again = solve(
            file.used_contacts,
            file.channels,
            method,
            file.noise,
            pipeline.session.surface,
            file.dead,
            pipeline.session.module_model,
        )
        for estimate in estimates:
            other = again[estimate.channel]
            assert estimate.state is other.state
            if estimate.position is not None:
                assert other.position is not None
                assert estimate.position.tobytes() == other.position.tobytes()

"""From device bytes to a written calibration file, and what the headless way needs."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from skincal.cli import main
from skincal.files.icub import read_icub
from skincal.files.reference import error_summary, read_reference
from skincal.mesh.lay import place_layout
from skincal.mesh.load import load_surface
from skincal.model.actions import AddLandmark, AskLandmark, action_to_json
from skincal.model.readings import Loss
from skincal.model.scene import load_scene, resource
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load, replay
from skincal.simulation.operator import Habits
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.virtual_session import simulate_session
from skincal.taxels.result import Method, State
from tests.approved import approved
from tests.skincal.record_support import told_to_poke
from tests.skincal.sim_support import SLOW_DEVICES

PATCH = resource("scenes/flat-patch/scene.toml")
FOREARM = resource("scenes/icub-forearm/scene.toml")
SERVE = ("simulate", "--serve", "--tcp", "--operator", "told", "--careful", "--pace", "4", "--seed", "4", "--scene")
CHANNELS = load_scene(FOREARM).skin.layout.channels[:24]
"""Taxels of the forearm that are poked: two modules."""


@pytest.fixture(scope="module")
def forearm(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Pipeline]:
    """Careful pokes on the forearm with sensor noise, in two arm poses."""
    scene = load_scene(FOREARM)
    assert scene.surface is not None
    folder = tmp_path_factory.mktemp("forearm") / "trial"
    surface, _ = load_surface(scene.surface)
    pipeline = simulate_session(
        scene, surface, folder, 40, 5, RigErrors.noise(),
        poses=("1", "6"), channels=CHANNELS, habits=Habits.careful(), settings=SLOW_DEVICES,
    )  # fmt: skip
    return folder, pipeline


@pytest.fixture(scope="module")
def patch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A few pokes on the flat patch."""
    folder = tmp_path_factory.mktemp("patch") / "trial"
    simulate_session(load_scene(PATCH), None, folder, 4, 2, RigErrors.noise(), habits=Habits.careful(), settings=SLOW_DEVICES)
    return folder


def test_bytes_become_a_calibration_file_that_is_right(forearm, tmp_path):
    folder, _ = forearm
    out = tmp_path / "results"
    assert main(["solve", str(folder), "--out", str(out)]) == 0
    truth = read_reference(folder / "truth.json")
    surface = read_icub(out / "positions-surface.txt")
    free = read_icub(out / "positions-free.txt")
    assert surface.shape == (384, 6)
    distance = [np.linalg.norm(surface[c, :3] - place) for c, place in truth.items() if surface[c, :3].any()]
    assert len(distance) >= len(CHANNELS)
    assert np.mean(distance) < 3e-3
    free_distance = [np.linalg.norm(free[c, :3] - place) for c, place in truth.items() if free[c, :3].any()]
    assert np.median(free_distance) < 8e-3
    touched = [c for c in truth if surface[c, :3].any()]
    assert np.allclose(np.linalg.norm(surface[touched, 3:], axis=1), 1.0, atol=1e-5)
    assert not surface[[c for c in range(384) if c not in truth]].any()


def test_the_file_of_the_session_is_the_session(forearm, tmp_path, capsys):
    """`solve` on the journal says what the live pipeline said, to the last bit."""
    folder, pipeline = forearm
    assert main(["solve", str(folder), "--out", str(tmp_path / "r"), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    live = pipeline.snapshot()
    document = json.loads((tmp_path / "r" / "calibration.json").read_text(encoding="utf-8"))
    assert said["accepted"] == sum(not r.excluded for r in live.pokes if hasattr(r.outcome, "responses"))
    summary = error_summary(live.estimates[Method.SURFACE], read_reference(folder / "truth.json"))
    assert summary is not None
    states = [e.state for e in live.estimates[Method.SURFACE]]
    assert said["methods"]["surface"]["states"]["touched"] == states.count(State.TOUCHED)
    text = json.dumps(document)
    for estimate in live.estimates[Method.SURFACE][:20]:
        if estimate.position is not None:
            assert repr(float(estimate.position[0])) in text


def test_every_reading_of_a_clean_line_arrives(forearm):
    _, pipeline = forearm
    live = pipeline.live(0)
    for link in live.links:
        assert link.readings > 1000
        assert link.losses.get(Loss.BAD_CHECKSUM, 0) == 0
        assert link.losses.get(Loss.MISSING, 0) == 0


LEAN = """
import sys, threading
from skincal.cli import main
code = main(["solve", {folder!r}, "--json"])
heavy = ("PySide6", "shiboken6", "vtkmodules", "pyvista", "pyvistaqt", "pyqtgraph", "matplotlib", "scipy", "trimesh", "serial")
present = [name for name in (*heavy, "skincal.mesh.load", "skincal.simulation.simulated_rig") if name in sys.modules]
print(code, present, threading.active_count(), file=sys.stderr)
"""


def test_solving_a_patch_imports_and_starts_nothing_it_does_not_need(patch):
    """Headless, without a mesh: no Qt, no VTK, no mesh reader, no serial port, one thread."""
    done = subprocess.run(
        [sys.executable, "-c", LEAN.format(folder=str(patch))], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stderr.strip().splitlines()[-1] == "0 [] 1"
    assert set(json.loads(done.stdout)["methods"]) == {"free", "modules"}


POKES = ("3 0 0 9", "3 25 90 9", "3 25 210 9") * 4
"""More than are needed: on a busy machine some are rejected."""


@pytest.mark.timeout(240)
def test_devices_of_another_process_are_recorded_and_solved(tmp_path, capsys):
    """The shipped patch served over TCP, told where to poke, recorded like any device, exported."""
    server = subprocess.Popen(
        [sys.executable, "-m", "skincal.cli", *SERVE, str(PATCH)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert server.stdin is not None
    assert server.stdout is not None
    with server:
        try:
            links = {link["name"]: link["address"] for link in json.loads(server.stdout.readline())["links"]}
            folder = tmp_path / "live"
            arguments = ["--wrench", links["wrench"], "--skin", links["skin"], "--scene", str(PATCH), "--out", str(folder)]
            with told_to_poke(server, *POKES, accepted=3):
                assert main(["record", *arguments, "--seconds", "120", "--json"]) == 0
        finally:
            server.terminate()
    said = json.loads(capsys.readouterr().out)
    assert said["accepted"] >= 3
    assert main(["export", str(folder), "--format", "csv", "--out", str(tmp_path / "c.csv")]) == 0
    rows = [line.split(",") for line in (tmp_path / "c.csv").read_text(encoding="utf-8").splitlines()]
    assert ",".join(rows[0]) == (
        "channel,module,method,state,contacts,x_m,y_m,z_m,nx,ny,nz,sd_mm,gain_raw_per_N,gain_sd_raw_per_N,gain_pokes,normal_sd_deg"
    )
    poked = next(row for row in rows if row[0] == "3")
    assert poked[2:5] == ["free", "touched", str(said["accepted"])]
    assert 1 <= int(dict(zip(rows[0], poked, strict=True))["gain_pokes"]) <= said["accepted"]
    unseen = next(row for row in rows[1:] if row[3] == "untouched")
    assert unseen[5:] == [*[""] * 9, "0", ""]


@pytest.mark.timeout(240)
def test_a_landmark_is_asked_for_while_a_recording_runs_without_a_window(tmp_path, monkeypatch, capsys):
    """A taxel's place is named as a landmark and asked for on stdin: the pokes at the taxel are found to be there."""
    scene = load_scene(PATCH)
    x, y, z = place_layout(scene.skin.layout, scene.skin.anchor, None).places[3].tolist()
    orders = [AddLandmark("pad", x, y, z), AskLandmark("pad"), AskLandmark("nose")]
    reading, writing = os.pipe()
    os.write(writing, b"".join(json.dumps(action_to_json(order)).encode() + b"\n" for order in orders))
    os.close(writing)
    with (
        os.fdopen(reading) as stdin,
        subprocess.Popen(
            [sys.executable, "-m", "skincal.cli", *SERVE, str(PATCH)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        ) as server,
    ):
        monkeypatch.setattr(sys, "stdin", stdin)
        try:
            links = {link["name"]: link["address"] for link in json.loads(server.stdout.readline())["links"]}
            arguments = ["--wrench", links["wrench"], "--skin", links["skin"], "--scene", str(PATCH), "--orders"]
            with told_to_poke(server, *POKES, accepted=3):
                done = main(["record", *arguments, "--out", str(tmp_path / "s"), "--seconds", "120"])
        finally:
            server.terminate()
    assert done == 0
    assert approved("landmark.order_refused", order='{"do": "ask_landmark", "name": "nose"}') in capsys.readouterr().err
    at = load(tmp_path / "s").snapshot().at_landmarks
    assert at == replay(tmp_path / "s").snapshot().at_landmarks
    # The first may have begun before it was asked for.
    assert len(at) >= 2
    assert set(at.values()) == {"pad"}


def test_the_readme_shows_what_the_sample_session_really_gives(capsys):
    """Word for word."""
    checkout = Path(__file__).resolve().parents[2]
    block = (checkout / "docs" / "manual.md").read_text(encoding="utf-8").split("```console\n")[1].split("```")[0]
    command, *shown = block.strip().splitlines()
    words = command.removeprefix("$ skincal ").split()
    assert main([word if "/" not in word else str(checkout / word) for word in words]) == 0
    assert capsys.readouterr().out.splitlines()[: len(shown)] == shown

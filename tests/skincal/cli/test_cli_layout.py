"""`solve` offers the corrected layout as a file, and `solve` and `export` use a layout that is given."""

from __future__ import annotations

import io
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from skincal.cli import main
from skincal.model.scene import load_scene, resource
from skincal.model.skin import load_layout
from skincal.simulation.device import DeviceSettings
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.virtual_session import simulate_session
from skincal.taxels.result import Method
from tests.approved import approved
from tests.skincal.files.json_reader import read_json
from tests.skincal.sim_support import sample_with, scene_and_surface

SAMPLE = resource("sessions/sample")
TRUTH = SAMPLE / "truth.json"
# Module 17 of the sample, planned mirrored and turned; 28 and 29 with each other's channels.
DAMAGE = (
    ("angle_deg = -180\nmirror = false", "angle_deg = 60   # by hand\nmirror = true"),
    ("first_channel = 336", "first_channel = 1"),
    ("first_channel = 348", "first_channel = 336"),
    ("first_channel = 1\n", "first_channel = 348\n"),
)


@dataclass
class Damaged:
    folder: Path
    out: Path
    """The corrected layout."""
    said: list[str]
    """What was said while it was written."""


@pytest.fixture(scope="module")
def damaged(tmp_path_factory):
    """The sample session with a layout that is wrong in three of seven modules, and the corrected one."""
    made = tmp_path_factory.mktemp("damaged")
    folder = sample_with(made, "modules.toml", *DAMAGE)
    out, said = made / "corrected.modules.toml", io.StringIO()
    with redirect_stdout(said):
        assert main(["solve", str(folder), "--layout-out", str(out)]) == 0
    return Damaged(folder, out, said.getvalue().splitlines())


def printed(run, *words, code=0):
    """What a command prints on stdout, or on stderr where it ends with another code than 0."""
    found, out, err = run(*words)
    assert found == code
    return err if code else out


def error(result: dict) -> float:
    return result["methods"]["modules"]["error_mm"]["mean"]


def test_the_corrected_layout_is_written_and_a_session_solved_with_it(damaged, answered):
    given, undamaged = load_layout(damaged.out, 384), load_scene(SAMPLE / "scene" / "scene.toml").skin.layout
    np.testing.assert_allclose(given.places, undamaged.places, atol=1e-9)
    assert "angle_deg = 180   # by hand" in damaged.out.read_text(encoding="utf-8")

    before = answered("solve", damaged.folder, "--reference", TRUTH)
    assert len(before["misfits"]) == 3
    assert before["layout"] == {
        "used": None,
        "changes": [
            {"module": 17, "angle_deg": 180, "mirror": False},
            {"module": 28, "first_channel": 336},
            {"module": 29, "first_channel": 348},
        ],
        "left": [],
        "written": None,
    }
    after = answered("solve", damaged.folder, "--reference", TRUTH, "--layout", damaged.out)
    assert (after["misfits"], after["layout"]["used"], after["layout"]["changes"]) == ([], str(damaged.out), [])
    right = answered("solve", SAMPLE, "--reference", TRUTH)
    assert error(before) > 2.0 * error(right)
    assert error(after) == pytest.approx(error(right), abs=0.01)


def test_it_says_what_it_corrects_and_where_it_is(damaged, run):
    change = approved(
        "modules_check.changes_of_three",
        turned=17,
        degrees=180,
        mirror="false",
        one_way=28,
        one_first=336,
        other_way=29,
        other_first=348,
    )
    assert f"corrected {change}" in damaged.said
    assert approved("layout_file.wrote", path=damaged.out) in damaged.said
    lines = printed(run, "solve", damaged.folder).splitlines()
    assert any(line.startswith(approved("modules_check.mirrored_clause", module=17)) for line in lines)
    assert any(line.startswith("surface") and "neighbours 1." in line for line in lines)
    assert approved("layout_file.says", change=change) in lines
    lines = printed(run, "solve", SAMPLE, "--layout", damaged.out).splitlines()
    assert approved("layout_file.solved_with", path=damaged.out) in lines


def test_where_nothing_is_wrong_no_file_is_written(tmp_path, run, answered):
    out = tmp_path / "new.toml"
    said = printed(run, "solve", SAMPLE, "--layout-out", out)
    assert approved("layout_file.not_written", path=out, count=7) in said
    assert answered("solve", SAMPLE, "--layout-out", out)["layout"]["written"] is None
    assert not out.exists()


def test_an_export_with_a_layout_is_of_that_layout(damaged, tmp_path, answered):
    files = [tmp_path / name for name in ("a.json", "b.json")]
    plan = damaged.folder / "scene" / "modules.toml"
    said = answered("export", SAMPLE, "--format", "json", "--out", files[0], "--layout", plan)
    assert said["layout"] == str(plan)
    assert read_json(files[0]).modules_text == plan.read_text(encoding="utf-8")
    assert "layout" not in answered("export", SAMPLE, "--format", "json", "--out", files[1])
    assert read_json(files[1]).modules_text != read_json(files[0]).modules_text
    wrong, right = ([estimate.position for estimate in read_json(file).estimates[Method.MODULES]] for file in files)
    assert all(position is not None for position in right)
    # Taxels whose own pokes contradict the wrong layout have no position.
    assert max(np.abs(a - b).max() for a, b in zip(wrong, right, strict=True) if a is not None) > 0.003


def test_bytes_are_judged_by_the_layout_that_is_given(damaged, tmp_path, answered):
    folder, settings = tmp_path / "s", DeviceSettings(wrench_hz=200.0, joints_hz=20.0)
    at = (341, 337, 338, 340)  # at the edge of a module whose channels are exchanged
    simulate_session(*scene_and_surface(), folder, 4, 1, RigErrors.noise(), channels=at, settings=settings)
    plain, replayed = (answered("solve", folder, "--layout", damaged.out, *more) for more in ((), ("--replay",)))
    assert plain["methods"] == replayed["methods"]
    plan = damaged.folder / "scene" / "modules.toml"
    wrong, judged = (answered("solve", folder, "--layout", plan, *more) for more in ((), ("--replay",)))
    assert wrong["rejected"] == plain["rejected"]
    assert judged["rejected"] != plain["rejected"], "neighbours of the wrong layout are no neighbours"


def test_a_session_without_a_layout_is_solved_with_one(tmp_path, run, answered):
    folder = sample_with(tmp_path, "scene.toml", ('modules = "modules.toml"\n', ""))
    plan = SAMPLE / "scene" / "modules.toml"
    said = answered("solve", folder, "--layout", plan, "--reference", TRUTH)
    assert error(said) < 1.0
    err = printed(run, "solve", folder, "--layout-out", tmp_path / "new.toml", code=2)
    assert approved("layout_file.scene_has_none") in err


def test_a_layout_that_does_not_fit_the_skin_is_refused(tmp_path, run):
    wide = tmp_path / "wide.toml"
    wide.write_text('[[modules]]\nid = 1\nkind = "triangle_12"\nfirst_channel = 380\n', encoding="utf-8")
    for command in (("solve", SAMPLE), ("export", SAMPLE, "--format", "csv", "--out", tmp_path / "c.csv")):
        err = printed(run, *command, "--layout", wide, code=2)
        assert approved("layout_file.beyond_frame", first=380, last=391, channels=384) in err
        assert approved("layout_file.no_such_file") in printed(run, *command, "--layout", tmp_path / "none.toml", code=2)
    assert not (tmp_path / "c.csv").exists()


def test_the_layout_that_was_read_is_not_overwritten(damaged, tmp_path, run):
    path = damaged.folder / "scene" / "modules.toml"
    text = path.read_text(encoding="utf-8")
    assert approved("layout_file.the_same_clause") in printed(
        run, "solve", SAMPLE, "--layout", path, "--layout-out", path, code=2
    )
    assert path.read_text(encoding="utf-8") == text
    missing = tmp_path / "none" / "new.toml"
    assert "does not exist" in printed(run, "solve", SAMPLE, "--layout", path, "--layout-out", missing, code=2)

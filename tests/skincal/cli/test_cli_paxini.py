"""`scene new --paxini`: a scene of three axes with the layout of a module, from the user's own package."""

import json

import numpy as np
import pytest

from skincal.model.scene import load_scene
from skincal.part.draft_preview import taxels_under_tip
from skincal.part.part_draft import PartDraft, open_draft, pushes_of, scene_text
from tests.skincal.files.paxini_support import dome, write_package

BOX = "v 0 0 0\nv 40 0 0\nv 40 30 0\nv 0 30 0\nv 0 0 5\nv 40 0 5\nv 40 30 5\nv 0 30 5\n" + "".join(
    f"f {a} {b} {c}\nf {a} {c} {d}\n"
    for a, b, c, d in ((1, 4, 3, 2), (5, 6, 7, 8), (1, 2, 6, 5), (2, 3, 7, 6), (3, 4, 8, 7), (4, 1, 5, 8))
)


def test_scene_new_writes_a_scene_of_three_axes_and_the_points_beside_it(run, tmp_path):
    package = write_package(tmp_path)
    (tmp_path / "box.obj").write_text(BOX)
    out = tmp_path / "part" / "scene.toml"
    arguments = ["scene", "new", "--mesh", str(tmp_path / "box.obj"), "--paxini", "25", "--paxini-sdk", str(package)]
    code, output, _ = run(*arguments, "--out", out)
    assert code == 0
    assert "MADE-UP_points.json" in output
    scene = load_scene(out)
    assert scene.skin.axes is not None
    assert (scene.skin.channels, scene.skin.frame_width, scene.skin.axes.unit, scene.skin.polarity) == (25, 75, "N", 1)
    points = json.loads((out.parent / "MADE-UP_points.json").read_text())["taxels"]
    assert np.array([each["position_m"] for each in points]) == pytest.approx(dome()[0] * 1e-3)
    # The draft reads it back, and writes the same file.
    draft = open_draft(out)
    assert (draft.axes, draft.skin_unit) == (3, "N")
    assert scene_text(draft, out.parent) == out.read_text()
    frame = np.arange(75.0)
    assert pushes_of(draft, [frame])[0].tolist() == frame[2::3].tolist()
    assert pushes_of(PartDraft(), [frame])[0] is frame
    code, _, error = run(*arguments, "--grid", "2x2@5mm", "--out", out)
    assert code == 2
    assert "exclude each other" in error
    code, _, error = run("scene", "new", "--mesh", tmp_path / "box.obj", "--paxini", ",", "--out", tmp_path / "other.toml")
    assert (code, "names no module" in error) == (2, True)
    assert not (tmp_path / "other.toml").exists()
    code, _, error = run("scene", "new", "--mesh", tmp_path / "box.obj", "--paxini-sdk", package, "--out", out)
    assert (code, "name the modules by --paxini" in error) == (2, True)


def test_a_new_scene_of_three_axes_says_its_unit_and_how_many_taxels_a_poke_may_press(run, tmp_path):
    (tmp_path / "box.obj").write_text(BOX)
    mesh, out = ["scene", "new", "--mesh", tmp_path / "box.obj"], tmp_path / "part" / "scene.toml"
    code, output, _ = run(*mesh, "--grid", "6x6@4mm", "--axes", "3", "--out", out)
    assert code == 0
    assert 'unit = "raw"' in out.read_text()
    assert "values are raw; write" in output
    assert "a poke may press 12 taxels (taxels_max)" in output
    assert load_scene(out).contacts.taxels_max == 12
    assert scene_text(open_draft(out), out.parent) == out.read_text()
    # A scene without the word keeps its bytes.
    short = out.read_text().replace('unit = "raw"', "#")
    out.write_text(short)
    assert scene_text(open_draft(out), out.parent) == short
    newtons, plain = tmp_path / "n" / "scene.toml", tmp_path / "p" / "scene.toml"
    assert run(*mesh, "--grid", "3x3@9mm", "--axes", "3", "--skin-unit", "N", "--out", newtons)[0] == 0
    assert (load_scene(newtons).skin.axes.unit, "taxels_max" in newtons.read_text()) == ("N", False)
    code, _, error = run(*mesh, "--grid", "6x6@4mm", "--skin-unit", "N", "--out", plain)
    assert (code, "add --axes 3" in error) == (2, True)
    assert run(*mesh, "--grid", "6x6@4mm", "--out", plain)[0] == 0
    assert not any(word in plain.read_text() for word in ('unit = "raw"', "axes", "taxels_max"))


@pytest.mark.parametrize("pitch_mm", [3.0, 4.0, 4.7, 6.0])
def test_the_limit_holds_for_a_tip_anywhere_on_a_grid(pitch_mm):
    """Counted: the taxels of a square grid within 6.5 mm of any place."""
    grid = np.arange(-5, 6) * pitch_mm
    x, y = (each.ravel() for each in np.meshgrid(grid, grid))
    most = max(
        int((np.hypot(x - a, y - b) <= 6.5).sum()) for a in np.linspace(0, pitch_mm, 9) for b in np.linspace(0, pitch_mm, 9)
    )
    assert most <= taxels_under_tip(pitch_mm * 1e-3) <= 1.6 * most

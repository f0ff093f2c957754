"""`scene new --paxini`: a scene of three axes with the layout of a module, from the user's own package."""

import json

import numpy as np
import pytest

from skincal.model.scene import load_scene
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

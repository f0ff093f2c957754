"""What `import skincal` offers: the same numbers as the commands, frozen tables, and a sentence for wrong input."""

import json
import subprocess
import sys
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from matplotlib.collections import PathCollection
from PIL import Image

import skincal
from skincal.cli import main
from skincal.guide.verdict import Check
from skincal.model.scene import resource
from skincal.taxels.result import Method

SAMPLE = resource("sessions/sample")


@pytest.fixture(scope="module")
def sample():
    return skincal.Session.load(SAMPLE)


@pytest.fixture(scope="module")
def plate(tmp_path_factory):
    """A plate of 80 x 60 x 5 mm, its top 25 mm above the sensor, a grid of 4 x 5 taxels, and pokes straight on four of them."""
    folder = tmp_path_factory.mktemp("plate")
    corners = "".join(f"v {x} {y} {z}\n" for x in (-40, 40) for y in (-30, 30) for z in (20, 25))
    faces = "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n"
    (folder / "plate.obj").write_text(corners + faces, encoding="utf-8")
    scene = skincal.Scene.from_mesh(
        folder / "scene.toml", folder / "plate.obj", unit="mm", layout="4x5@9mm", anchor=(0.004, 0.002, 0.025)
    )
    plan, rows = scene.plan, [0, 3, 7, 9]
    assert np.allclose(plan.position[:, 2], 0.025)
    force = np.tile([0.0, 0.0, -6.0], (4, 1))
    wrench = np.hstack([force, np.cross(plan.position[rows], force)])
    responses = np.zeros((4, scene.channels))
    responses[range(4), plan.channel[rows]] = 100.0
    return scene, rows, wrench, responses


def test_names_are_offered_without_loading_numpy():
    code = "import sys, skincal; print(sorted(set(skincal.__all__) - set(dir(skincal))), 'numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split() == [
        "[]",
        "False",
    ]
    for name in skincal.__all__:
        assert getattr(skincal, name).__doc__
    rooms = {path.stem for path in Path(skincal.__file__).parent.iterdir()}
    assert not rooms & set(skincal.__all__), "an import of the room would hide the name"
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        skincal.nothing  # noqa: B018


def test_a_loaded_session_has_the_numbers_of_the_command(sample, capsys, tmp_path):
    main(["export", str(SAMPLE), "--format", "json", "--out", str(tmp_path / "command.json")])
    capsys.readouterr()
    sample.export(tmp_path / "script.json", "json")
    assert (tmp_path / "script.json").read_bytes() == (tmp_path / "command.json").read_bytes()
    taxels = sample.taxels("surface")
    read = json.loads((tmp_path / "script.json").read_text(encoding="utf-8"))
    known = {each["channel"]: each for each in read["estimates"]["surface"] if each["position_m"] is not None}
    assert sorted(known) == taxels.channel[taxels.is_known].tolist()
    for row in np.flatnonzero(taxels.is_known):
        same = known[int(taxels.channel[row])]
        np.testing.assert_array_equal(taxels.position[row], same["position_m"])
        np.testing.assert_array_equal(taxels.normal[row], same["normal"])
        assert taxels.state[row] == same["state"]
    assert taxels.compare(f"{SAMPLE}:surface").worst == 0.0
    assert taxels.compare(sample.truth).mean < 5e-3


def test_a_point_of_a_force_line_is_found_from_arrays_alone(plate):
    """By hand: the line of each poke passes its taxel, and the surface fixes the point on it."""
    scene, rows, wrench, responses = plate
    session = skincal.solve(scene, wrench, responses)
    assert session.rejections == {}
    taxels = session.taxels("surface")
    at = scene.plan.channel[rows]
    found = np.searchsorted(taxels.channel, at)
    np.testing.assert_allclose(taxels.position[found], scene.plan.position[rows], atol=1e-9)
    assert set(taxels.contacts.tolist()) == {0, 1}


def test_pokes_that_do_not_count_are_named(plate):
    scene, _, wrench, responses = plate
    soft, dark = wrench.copy(), responses.copy()
    soft[1] *= 1e-3
    dark[2] = 0.0
    reasons = skincal.solve(scene, soft, dark).rejections
    assert sorted(reasons) == [2, 3]
    assert "N" in reasons[2]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda given: {**given, "wrenches": given["wrenches"][:, :5]}, r"wrenches: has the shape \(4, 5\); expected \(n, 6\)"),
        (lambda given: {**given, "responses": given["responses"][:3]}, r"responses: has the shape \(3, \d+\); expected \(4, "),
        (lambda given: {**given, "wrenches": "force"}, "wrenches: is no array of numbers"),
        (lambda given: {**given, "wrenches": given["wrenches"] * np.nan}, "row 0 has a value that is no number"),
        (lambda given: {**given, "poses": np.tile(2.0 * np.eye(4), (4, 1, 1))}, "poses: row 0 is no pose"),
        (lambda given: {**given, "poses": np.tile(np.diag([1.0, 1.0, -1.0, 1.0]), (4, 1, 1))}, "poses: row 0 is no pose"),
        (lambda given: {**given, "times": [1.0]}, r"times: has the shape \(1,\); expected \(4,\)"),
    ],
)
def test_wrong_arrays_are_refused_with_their_shape(plate, change, said):
    scene, _, wrench, responses = plate
    with pytest.raises(skincal.InputError, match=said):
        skincal.solve(scene, **change({"wrenches": wrench, "responses": responses}))


def test_a_moving_arm_needs_its_poses():
    scene = skincal.Scene.load("icub-forearm")
    with pytest.raises(skincal.InputError, match="expected poses"):
        skincal.solve(scene, np.zeros((1, 6)), np.zeros((1, scene.channels)))


def test_tables_are_frozen_and_shown_in_notebooks(sample):
    taxels = sample.taxels()
    with pytest.raises(ValueError, match="read-only"):
        taxels.position[0] = 0.0
    shown = taxels.html()
    assert shown.count("<tr>") == 14
    assert "millimetres" in shown
    assert sample._repr_html_().endswith("</table>")
    assert str(sample.verdict()) == sample.verdict().sentence


@pytest.mark.parametrize(("inside", "finished"), [(9, False), (10, True)])
def test_a_session_is_finished_only_with_enough_test_pokes(sample, monkeypatch, inside, finished):
    found = sample.results.verdict(Method.MODULES)
    tested = replace(found, enough=True, done=found.used, left=(), check=Check(inside, inside))
    monkeypatch.setattr(sample.results, "verdict", lambda _method: tested)
    judged = sample.verdict("modules")
    assert (judged.enough, judged.finished) == (True, finished)
    assert judged.sentence.startswith("Not finished") is not finished


def test_a_data_frame_has_a_row_a_taxel(sample):
    pytest.importorskip("pandas")
    frame = sample.taxels("free").to_pandas()
    assert list(frame.columns) == ["module", "state", "contacts", "x", "y", "z", "nx", "ny", "nz", "error"]
    assert len(frame) == len(sample.taxels("free"))


def test_figures_show_every_known_taxel(sample):
    taxels = sample.taxels("surface")
    dots = [each for axes in taxels.plot().axes for each in axes.collections if isinstance(each, PathCollection)]
    assert [len(each.get_offsets()) for each in dots] == [int(taxels.is_known.sum())] * 3


def test_a_notebook_shows_the_figure_without_pyplot(sample):
    figure = sample.taxels("surface").plot()
    with Image.open(BytesIO(figure._repr_png_())) as shown:
        assert shown.size[0] > 2 * shown.size[1]


def test_a_picture_in_space_needs_no_window(sample, tmp_path):
    taxels = sample.taxels("surface")
    taxels.plot_3d(sample.scene.part, tmp_path / "taxels.png")
    with Image.open(tmp_path / "taxels.png") as drawn:
        colours = {tuple(pixel) for pixel in np.asarray(drawn.convert("RGB")).reshape(-1, 3).tolist()}
    assert len(colours) > 50, "the part and the balls of its modules"


def test_a_scene_is_made_from_a_mesh_and_refused_with_a_sentence(plate, tmp_path):
    scene, *_ = plate
    assert (scene.channels, scene.methods, scene.link) == (20, ("free", "surface", "modules"), "part")
    spacing = np.linalg.norm(np.diff(scene.plan.position[:5], axis=0), axis=1)
    np.testing.assert_allclose(spacing, 0.009, atol=1e-9)
    with pytest.raises(skincal.InputError, match=r"none\.stl"):
        skincal.Scene.from_mesh(tmp_path / "scene.toml", tmp_path / "none.stl", channels=4)
    with pytest.raises(skincal.InputError, match="height: is no entry of a part; expected one of layout, channels"):
        skincal.Scene.from_mesh(tmp_path / "scene.toml", scene.path.parent / "plate.obj", height=0.1)
    with pytest.raises(skincal.InputError, match="anchor: has the shape"):
        skincal.Scene.from_mesh(tmp_path / "scene.toml", scene.path.parent / "plate.obj", layout="2x2@5mm", anchor=(0.0, 0.0))
    assert list(tmp_path.iterdir()) == []


def test_a_scene_is_made_from_a_robot_with_a_joint_that_does_not_move(tmp_path):
    """The chain with a fixed joint, its angle in radians, is the whole chain at that angle."""
    urdf, names = resource("examples/carrying_arm.urdf"), {"link": "r_forearm_dh_frame", "sensor": "wrist_ft", "channels": 4}
    both = skincal.Scene.from_urdf(tmp_path / "both/scene.toml", urdf, joints=["bend", "twist"], copy=False, **names)
    one = skincal.Scene.from_urdf(tmp_path / "one/scene.toml", urdf, joints=["bend"], fixed={"twist": 0.5}, sign=-1, **names)
    assert (both.link, both.channels, both.methods, both.wrench_sign, one.wrench_sign) == (names["link"], 4, ("free",), 1, -1)
    arms = [scene.part.scene.arm.arm for scene in (both, one)]
    np.testing.assert_allclose(
        arms[1].link_from_sensor(np.array([0.3])), arms[0].link_from_sensor(np.array([0.3, 0.5])), atol=1e-9
    )
    assert [path.name for path in tmp_path.rglob("*.urdf")] == ["carrying_arm.urdf"]
    with pytest.raises(skincal.InputError, match="knee_ft"):
        skincal.Scene.from_urdf(tmp_path / "no/scene.toml", urdf, **names | {"sensor": "knee_ft"})


@pytest.mark.parametrize(
    ("ask", "said"),
    [
        (lambda session: session.taxels("modul"), "method: is 'modul'; expected one of free, surface, modules"),
        (lambda session: session.export("out.txt", "ikub"), "format: is 'ikub'; expected one of"),
        (lambda session: session.export("out.json", "json", options=skincal.ExportOptions(part="r_arm")), "part"),
    ],
)
def test_wrong_words_are_refused(sample, ask, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(skincal.InputError, match=said):
        ask(sample)
    assert list(tmp_path.iterdir()) == []

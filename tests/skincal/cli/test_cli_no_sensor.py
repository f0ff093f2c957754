"""The commands with a rig that has no force sensor: record, landmarks, solve."""

import json
from types import SimpleNamespace

import skincal
from skincal.cli.landmarks import _names_by_shape
from skincal.model.scene import load_scene
from skincal.session.landmark_pokes import LandmarkNames
from skincal.words.units import millimetres, point_mm
from tests.skincal.session.test_no_sensor import EVERY, RADIUS, TIP, chunks, scene_of, scene_text


def test_a_recording_without_a_wrench_is_calibrated_by_the_commands(tmp_path, run):
    scene_of(tmp_path, scene_text())
    lines = {"skin": b"", "tool": b""}
    for chunk in chunks(EVERY[:6]):
        lines[chunk.link] += chunk.data
    for name, data in lines.items():
        (tmp_path / f"{name}.txt").write_bytes(data)
    options = [f"--{name}=file:{tmp_path / name}.txt" for name in lines]
    code, out, _ = run("record", *options, "--scene", tmp_path / "scene.toml", "--out", tmp_path / "s")
    assert (code, "2 accepted" in out) == (0, True)
    assert "Part: its pose in the base is not known yet" in out
    truth = tmp_path / "truth.json"
    truth.write_text(json.dumps({"taxels": [{"channel": channel, "position_m": [0, 0, 0]} for channel in range(9)]}))
    code, out, _ = run("solve", tmp_path / "s", "--reference", truth, "--out", tmp_path / "r")
    assert (code, "The reference is not compared" in out, "outside the box" in out) == (0, True, False), "two frames"
    assert "error against the reference" not in out
    code, out, _ = run("landmarks", tmp_path / "s", "--find")
    assert (code, "have the shape of 4 landmarks" in out, "wrote poke 4 at m3, 0." in out) == (0, True, True)
    assert "took back poke 4 at m3" in run("landmarks", tmp_path / "s", "--undo")[1]
    code, out, _ = run("landmarks", tmp_path / "s", "--at", "1=m0")
    assert (code, "wrote poke 1 at m0\n" in out, "do not show yet" in out) == (0, True, True), "no distance between frames"
    assert "mm from it" not in run("landmarks", tmp_path / "s")[1]
    (tmp_path / "s" / "truth.json").write_text(truth.read_text())
    link = load_scene(tmp_path / "scene.toml").link
    truth.write_text(json.dumps({"link": link, **json.loads(truth.read_text())}))
    code, _, err = run("compare", f"{tmp_path / 's'}:free", truth)
    assert (code, "is in the frame of 'base'" in err) == (2, True), err
    assert skincal.Session.load(tmp_path / "s").taxels("free").link == "base"
    run("report", tmp_path / "s", "--out", tmp_path / "r.html")
    page = (tmp_path / "r.html").read_text()
    assert ("Positions are in the frame base" in page, "against the truth" in page) == (True, False)
    marks = [word for row in range(4) for word in ("--at", f"{row + 1}=m{row}")]
    code, out, _ = run("landmarks", tmp_path / "s", *marks)
    assert (code, "they show the part's pose" in out, "its axis" in out) == (0, True, False), "a tip has no axis"
    code, out, _ = run("solve", tmp_path / "s", "--reference", truth, "--json")
    solved = json.loads(out)
    assert (code, solved["tip"]["part"]["state"]) == (0, "known")
    assert all(each["error_mm"] for each in solved["methods"].values()), "compared in one frame"
    code, _, err = run("record", options[0], "--scene", tmp_path / "scene.toml", "--out", tmp_path / "t")
    assert (code, "or --tool" in err) == (2, True)


def test_find_says_how_sure_the_shape_of_the_touched_points_is_and_writes_no_name_of_two():
    def said(names, rival=None, **session):
        found = LandmarkNames(names, rival, 0.0004)
        return _names_by_shape(SimpleNamespace(has_used_tip=True, landmarks_by_shape=lambda _: found, **session), {})

    three = {1: "a", 2: "b", 3: "c"}
    names, (words,) = said(three)
    assert names == three
    assert "a touch of a fourth landmark would confirm it" in words
    assert "fourth" not in said({**three, 4: "d"})[1][0]
    names, (words,) = said(three, {1: "a", 2: "c", 4: "b"})
    assert names == {}
    assert "poke 2 at b or c, poke 3 at c or none, poke 4 at none or b." in words
    assert "--at" in words


def test_the_help_keeps_words_in_brackets(run):
    for words in (("record",), ("import", "csv")):
        assert "[tool]" in run(*words, "--help")[1], "rich takes [tool] for markup"


def test_scene_show_names_the_tool_and_no_fixed_pose_of_a_sensor(tmp_path, run):
    scene = tmp_path / "scene.toml"
    scene_of(tmp_path, scene_text())
    code, out, _ = run("scene", "show", scene)
    assert (code, "pose of the sensor" in out) == (0, False)
    assert f"  tip_mm: {point_mm(TIP)} mm in the tool's frame\n  tip_radius_mm: {millimetres(RADIUS)}\n" in out
    assert "  sensor: none\n  poses: as the stream defines them\n" in out
    scene_of(tmp_path, scene_text("rotation = 'vector'\nunit = 'mm'\ndegrees = true\n"))
    assert "  poses: rotation vector in degrees, lengths in mm\n" in run("scene", "show", scene)[1]
    assert json.loads(run("scene", "show", scene, "--json")[1])["link_from_sensor"] is None
    flange = "[[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0.02], [0, 0, 0, 1]]"
    scene_of(tmp_path, scene_text(f"flange = {flange}\n").replace('"none"', '"tool"'))
    code, out, _ = run("scene", "show", scene)
    assert "  flange: sensor at 0.0  0.0  20.0 mm in the tool's frame, turned by 90.0°\n  tolerance_deg: 1.0°\n" in out
    assert "pose of the sensor" not in out
    # An arm's scene has one pose of its sensor at given angles.
    code, out, _ = run("scene", "show", "icub-forearm")
    assert ("pose of the sensor in the link" in out, "tip_mm" in out) == (True, False)

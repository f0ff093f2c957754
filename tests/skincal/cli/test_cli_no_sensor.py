"""The commands with a rig that has no force sensor: record, landmarks, solve."""

import json

from tests.skincal.session.test_no_sensor import EVERY, chunks, scene_of, scene_text


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
    marks = [word for row in range(4) for word in ("--at", f"{row + 1}=m{row}")]
    code, out, _ = run("landmarks", tmp_path / "s", *marks)
    assert (code, "they show the part's pose" in out) == (0, True)
    code, out, _ = run("solve", tmp_path / "s", "--json")
    assert (code, json.loads(out)["tip"]["part"]["state"]) == (0, "known")
    code, _, err = run("record", options[0], "--scene", tmp_path / "scene.toml", "--out", tmp_path / "t")
    assert (code, "or --tool" in err) == (2, True)

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from skincal.files.importers.preview import RecordingFiles, guess_streams, preview_recording
from skincal.files.importers.registry import RecordedPlace
from skincal.geometry import Arm, DhLink
from skincal.model.errors import InputError
from skincal.model.readings import Stream
from skincal.model.scene import ArmSpec
from tests.approved import approved
from tests.skincal.import_support import EPOCH, write_csv, write_log, write_yarp
from tests.skincal.poke_script import PERIOD_S, Script, small_scene, some_pokes

SAMPLES = some_pokes(small_scene(), 3).samples


def files_of(wrench=None, skin=None, joints=None):
    return RecordingFiles(*(None if path is None else RecordedPlace(path) for path in (wrench, skin, joints)))


def test_a_folder_of_ports_is_told_apart(tmp_path):
    folder = write_yarp(tmp_path / "log", SAMPLES, joints=5)
    found = guess_streams([folder])
    assert found == files_of(folder / "left_ft", folder / "left_forearm_skin", folder / "left_arm")
    assert found.importer.name == "yarp"
    # One port of it, the logs themselves, and a folder above lead to the same.
    assert guess_streams([folder / "left_ft"]) == found
    assert guess_streams([tmp_path]) == found
    logs = [folder / name / "data.log" for name in ("left_arm", "left_ft", "left_forearm_skin")]
    assert guess_streams(logs) == files_of(logs[1], logs[2], logs[0])


def test_tables_are_told_apart_by_their_columns(tmp_path):
    folder = write_csv(tmp_path, SAMPLES)
    (folder / "c.csv").write_text("t_s,first_deg,second_rad\n0,1,2\n")
    found = guess_streams([folder])
    assert found == files_of(folder / "a.csv", folder / "b.csv", folder / "c.csv")
    assert found.importer.name == "csv"
    assert guess_streams([folder / "b.csv", folder / "a.csv"]) == files_of(folder / "a.csv", folder / "b.csv")


def test_without_a_header_the_number_of_columns_and_the_name_say_it(tmp_path):
    for name, width in (("one.csv", 6), ("two.csv", 24), ("three.csv", 7), ("joints.tsv", 6)):
        (tmp_path / name).write_text("\t".join(["0"] * (1 + width)) + "\n")
    assert guess_streams([tmp_path]) == files_of(tmp_path / "one.csv", tmp_path / "two.csv", tmp_path / "three.csv")
    log = write_log(tmp_path / "y" / "loadcell", [0.0, 0.1], [np.arange(6.0)] * 2)
    assert guess_streams([log]).wrench.path == log
    state = write_log(tmp_path / "z" / "joint_state", [0.0, 0.1], [np.arange(6.0)] * 2)
    assert guess_streams([state]) == files_of(joints=state)


def test_the_skin_of_a_folder_with_many_ports_is_found(tmp_path):
    for index in range(80):
        (tmp_path / f"a{index:02d}.csv").write_text("t_s,first_deg,second_rad\n0,1,2\n")
    folder = write_csv(tmp_path, SAMPLES)
    (folder / "b.csv").rename(folder / "zz_skin.csv")
    assert guess_streams([folder]).skin.path == folder / "zz_skin.csv"


def test_what_is_no_recording_is_refused(tmp_path):
    (tmp_path / "note.csv").write_text("some words,and more\n")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="no column is the time; seen some words, and more"):
        guess_streams([tmp_path / "note.csv"])
    for paths in ([tmp_path / "empty"], [tmp_path / "gone"]):
        with pytest.raises(InputError, match="no recording was found"):
            guess_streams(paths)


@pytest.mark.parametrize(
    ("files", "sentence"),
    [
        (files_of(skin=Path("b")), "overview.no_wrench"),
        (files_of(Path("a"), joints=Path("c")), "overview.no_skin"),
    ],
)
def test_both_devices_are_needed(files, sentence):
    known = {"overview.no_wrench": approved("overview.no_wrench"), "overview.no_skin": approved("overview.no_skin")}
    with pytest.raises(InputError) as refusal:
        files.open()
    assert str(refusal.value) == known[sentence]


def test_files_of_two_kinds_are_read_together_and_it_is_said(tmp_path):
    yarp, tables = write_yarp(tmp_path / "yarp", SAMPLES, per_frame=1), write_csv(tmp_path / "tables", SAMPLES)
    shifted = [line.split(",", 1) for line in (tables / "b.csv").read_text().splitlines()[1:]]
    head = (tables / "b.csv").read_text().splitlines()[0]
    rows = [f"{EPOCH + float(time):.6f},{rest}" for time, rest in shifted]
    (tables / "b.csv").write_text("\n".join([head, *rows, ""]))
    opened = files_of(yarp / "left_ft", tables / "b.csv").open()
    assert [timeline.lines for timeline in opened.timelines] == [len(SAMPLES)] * 2
    assert any("two kinds (Logs of yarpdatadumper and CSV tables): their clocks must agree" in each for each in opened.findings)


def test_a_look_says_what_is_there(tmp_path):
    preview = preview_recording(guess_streams([write_yarp(tmp_path, SAMPLES, joints=5)]))
    wrench, skin, joints = preview.streams
    assert (wrench.stream, skin.stream, joints.stream) == (Stream.WRENCH, Stream.SKIN, Stream.JOINTS)
    assert (wrench.rows, skin.rows) == (4 * len(SAMPLES), len(SAMPLES))
    assert (wrench.width, skin.width, joints.width) == (6, 24, 5)
    assert wrench.rate == pytest.approx(4 / PERIOD_S, rel=1e-3)
    assert skin.seconds == pytest.approx(PERIOD_S * (len(SAMPLES) - 1), abs=1e-5)
    assert wrench.first == pytest.approx(SAMPLES[0].wrench, rel=1e-6)
    assert joints.first == pytest.approx(np.arange(5) + 0.5)
    assert preview.findings == ()


def test_the_curve_has_the_pokes_beside_the_offset(tmp_path):
    script = Script(small_scene()).quiet(2.0)
    script.press(np.array([0.0, 3.0, -4.0]), np.array([0.0, 0.0, 0.1]), {3: 80.0}, hold_s=0.5).quiet(2.0)
    preview = preview_recording(guess_streams([write_csv(tmp_path, script.samples)]))
    assert np.nanmax(preview.force) == pytest.approx(5.0, abs=1e-3)
    assert 0.4 <= 0.1 * (preview.force > 4.9).sum() <= 0.8
    assert 2.0 <= preview.times[np.nanargmax(preview.force)] <= 2.6
    assert preview.times[-1] == pytest.approx(PERIOD_S * (len(script.samples) - 1), abs=0.1)


def test_gaps_and_missing_numbers_are_said(tmp_path):
    script = Script(small_scene()).quiet(2.0).gap(3.0).quiet(2.0)
    folder = write_csv(tmp_path, script.samples)
    lines = (folder / "a.csv").read_text().splitlines()
    lines[0] += ",seq"
    lines[1:] = [f"{line},{k + (k > 20)}" for k, line in enumerate(lines[1:])]
    (folder / "a.csv").write_text("\n".join(lines) + "\n")
    found = preview_recording(guess_streams([folder])).findings
    assert approved("overview.missing", name="wrench", count=1) in found
    assert sum("1 gap in time, the longest 3.0" in sentence for sentence in found) == 2


def test_what_does_not_fit_the_scene_is_said(tmp_path):
    arm = ArmSpec(Arm((3,), (DhLink(0.0, 0.1, 0.0, 0.0),), np.eye(4)), {"low": np.array([0.0])})
    scene, wide = small_scene(), small_scene(channels=30, layout=False)
    preview = preview_recording(guess_streams([write_yarp(tmp_path / "plain", SAMPLES)]))
    assert preview.misfits(scene, "") == ()
    assert preview.misfits(wide, "") == (approved("overview.width", found=24, scene="script", wanted=30),)
    with_arm = replace(scene, arm=arm)
    assert preview.misfits(with_arm, "low") == ()
    assert preview.misfits(with_arm, "") == (approved("overview.pose"),)
    few = preview_recording(guess_streams([write_yarp(tmp_path / "few", SAMPLES, joints=2)]))
    assert few.misfits(with_arm, "") == (approved("overview.joints", found=2, wanted=4),)
    many = preview_recording(guess_streams([write_yarp(tmp_path / "many", SAMPLES, joints=4)]))
    assert many.misfits(with_arm, "") == ()


def test_a_look_ends_where_nobody_wants_it(tmp_path):
    preview = preview_recording(guess_streams([write_yarp(tmp_path, SAMPLES)]), lambda: False)
    assert len(preview.force) == 0
    assert preview.streams[0].rows


def test_a_long_recording_is_decoded_for_a_minute(tmp_path):
    times = np.arange(0.0, 200.0, 0.1)
    write_log(tmp_path / "ft", times.tolist(), [np.array([time > 100, 0, 0, 0, 0, 0.0]) for time in times])
    write_log(tmp_path / "skin", times.tolist(), [np.zeros(24)] * len(times))
    preview = preview_recording(guess_streams([tmp_path]))
    assert preview.streams[0].seconds == pytest.approx(199.9, abs=1e-3)
    assert preview.times[-1] <= 60.0
    assert np.nanmax(preview.force) == 0.0

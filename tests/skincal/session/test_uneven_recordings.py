"""Streams that pause, freeze, come in groups or have too few digits: right taxels, or a sentence that says what is missing."""

import numpy as np
import pytest

from skincal.cli import main
from skincal.contacts.outcome import Contact, Reason, Rejection
from skincal.files.importers.preview import RecordingFiles, preview_recording
from skincal.files.importers.registry import RecordedPlace
from skincal.model.readings import SENSOR_STREAMS, Stream
from skincal.session.importing import ImportRequest, import_recording
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load
from skincal.words.poke_words import LATE_ANGLES_ADVICE, rejection_advice, rejection_words
from tests.approved import approved
from tests.skincal.uneven_rig import (
    MOVE_S,
    POKES,
    arrive_in_groups,
    errors_mm,
    record_rig,
    write_arm_scene,
    write_logs,
    write_rig_bag,
    write_tables,
)

WRITERS = [write_tables, write_logs, write_rig_bag]
RIGHT_MM = 0.5
"""Largest error of a force axis with 0.02 N of noise; a wrong arm pose makes 20 and more."""


@pytest.fixture(scope="module")
def recorded_once(tmp_path_factory):
    return record_rig(write_arm_scene(tmp_path_factory.mktemp("source")))


@pytest.fixture
def rig(recorded_once, tmp_path):
    return recorded_once.copy_for(write_arm_scene(tmp_path / "source"))


@pytest.fixture
def imported(rig, tmp_path, capfd):
    """Import by arguments; give the exit code, what was said, and the snapshot of the session."""

    def run(arguments):
        capfd.readouterr()
        code = main(["import", *arguments, "--scene", str(rig.scene.path), "--out", str(tmp_path / "s")])
        said = "".join(capfd.readouterr())
        return code, said, load(tmp_path / "s").snapshot() if code == 0 else None

    return run


def poke_times(snapshot, reason=None):
    """Times of the beginnings of still windows, s from the first reading, of contacts or of one reason's rejections."""
    kind = Contact if reason is None else Rejection
    found = [r.outcome for r in snapshot.pokes if isinstance(r.outcome, kind)]
    return np.array([o.start_s - 1.0 for o in found if reason is None or o.reason is reason])


def files_of(folder):
    """Tables of `write_tables`."""
    return RecordingFiles(*(RecordedPlace(folder / f"{stream.value}.csv") for stream in SENSOR_STREAMS))


@pytest.mark.parametrize("write", WRITERS)
def test_the_recording_is_right_without_a_fault(rig, imported, write, tmp_path):
    code, said, snapshot = imported(write(tmp_path / "r", rig))
    assert code == 0
    assert len(poke_times(snapshot)) == POKES
    assert sum(e.position is not None for found in snapshot.estimates.values() for e in found) >= 6
    assert max(errors_mm(snapshot)) < RIGHT_MM
    assert not [word for word in ("gap", "repeats", "unknown", "every value") if word in said]


@pytest.mark.parametrize(
    ("write", "until", "pokes"), [(write_tables, 1e9, 8), *((write, MOVE_S + 6.5, 5) for write in WRITERS)]
)
def test_pokes_while_the_joints_pause_and_the_arm_moves_do_not_count(rig, imported, write, until, pokes, tmp_path):
    """The stream pauses before the arm moves: angles that are held would put pokes 30 mm beside."""
    begin = MOVE_S - 5.0
    times = rig.times[Stream.JOINTS]
    rig.keep(Stream.JOINTS, (times <= begin) | (times > until))
    code, said, snapshot = imported(write(tmp_path / "r", rig))
    assert code == 0
    assert max(errors_mm(snapshot)) < RIGHT_MM
    lost = poke_times(snapshot, Reason.NO_POSE)
    assert len(lost) == POKES - len(poke_times(snapshot)) == pokes
    assert ((lost > begin) & (lost < until)).all()
    assert f"arm pose unknown: {len(lost)}" in said
    assert approved("recording.late_angles", pokes=f"{len(lost)} pokes") in said
    assert ("joints: ends" in said and "the arm pose of pokes after it is unknown" in said) == (until > 1e8)
    assert "not found" not in said


@pytest.mark.parametrize("write", WRITERS)
def test_the_joints_of_an_arm_at_rest_may_pause(rig, imported, write, tmp_path):
    """A device that sends changes only: the next angles are those before, or begin to change."""
    times = rig.times[Stream.JOINTS]
    rig.keep(Stream.JOINTS, (times < 1.0) | ((times > MOVE_S - 0.1) & (times < MOVE_S + 1)) | (times > times[-1] - 0.1))
    code, said, snapshot = imported(write(tmp_path / "r", rig))
    assert code == 0
    assert len(poke_times(snapshot)) == POKES
    assert max(errors_mm(snapshot)) < RIGHT_MM
    assert "unknown" not in said


def test_a_joint_that_falls_silent_makes_the_arm_pose_unknown(rig, imported, tmp_path):
    times = rig.times[Stream.JOINTS]
    silent = dict.fromkeys(np.flatnonzero(times > MOVE_S - 5.0).tolist(), ("elbow",))
    code, said, snapshot = imported(write_rig_bag(tmp_path / "r", rig, silent))
    assert code == 0
    assert max(errors_mm(snapshot)) < RIGHT_MM
    assert len(poke_times(snapshot, Reason.NO_POSE)) == POKES - len(poke_times(snapshot)) == POKES // 2 + 2
    assert "joints: no position of wrist came with" in said
    assert f"first after {MOVE_S - 5.0:.1f} s" in said


def test_two_publishers_of_one_joint_each_are_no_silence(rig, imported, tmp_path):
    """One of them four times slower, as a hand may be."""
    turns = {k: ("elbow",) if k % 5 else ("wrist",) for k in range(len(rig.times[Stream.JOINTS]))}
    code, _, snapshot = imported(write_rig_bag(tmp_path / "r", rig, turns))
    assert code == 0
    # The last step of the slow joint ends the quiet time before the poke after the move.
    assert len(poke_times(snapshot)) == len(snapshot.pokes) == POKES - 1
    assert max(errors_mm(snapshot)) < RIGHT_MM


def test_a_joint_without_a_number_is_silent_and_an_unused_column_may_be(rig, imported, tmp_path):
    late = rig.times[Stream.JOINTS] > MOVE_S - 5.0
    rig.rows[Stream.JOINTS][late, 1] = np.nan
    code, said, snapshot = imported(write_tables(tmp_path / "r", rig))
    assert code == 0
    assert max(errors_mm(snapshot)) < RIGHT_MM
    assert len(poke_times(snapshot)) == POKES // 2 - 2
    assert "arm pose unknown" in said


def test_the_advice_on_late_angles_leads_to_the_poke(rig, tmp_path):
    """Live: the operator starts the program of the joints again, and the arm rested. The lost pokes count."""
    times = rig.times[Stream.JOINTS]
    rig.keep(Stream.JOINTS, (times < 4.0) | ((times > 10.0) & (times < 12.0)))
    write_tables(tmp_path / "r", rig)
    recording = files_of(tmp_path / "r").open()
    pipeline = Pipeline(rig.scene, recording.links, None)
    told = {}
    for chunk in recording.chunks():
        pipeline.feed(chunk)
        told |= {int(chunk.host_ns * 1e-9 - 1.0): [record.outcome for record in pipeline.snapshot(0.0).pokes]}
    pipeline.close()
    before, after = told[9], [record.outcome for record in pipeline.snapshot().pokes]
    assert [isinstance(each, Contact) for each in before] == [True] * 2 + [False] * 2
    for rejected in before[2:]:
        assert rejection_advice(rejected) == LATE_ANGLES_ADVICE
        assert rejection_words(rejected).startswith("arm pose unknown: its joint angles are")
    assert [isinstance(each, Contact) for each in after] == [True] * 6 + [False] * 6
    assert max(errors_mm(pipeline.snapshot())) < RIGHT_MM


@pytest.mark.parametrize(("write", "digits"), [(write_tables, ".5E"), (write_tables, ".0f"), (write_logs, ".0f")])
def test_times_with_too_few_digits_are_refused(rig, imported, write, digits, tmp_path):
    if digits == ".5E":
        for stream in rig.times:
            rig.times[stream] = rig.times[stream] + 1e9
    code, said, _ = imported(write(tmp_path / "r", rig, digits))
    assert code == 2
    assert approved("recording.coarse_times") in said
    assert not (tmp_path / "s").exists()


def test_stamps_with_too_few_digits_give_way_to_the_arrival(rig, imported, tmp_path):
    """A driver that fills in whole seconds: the recorder's own times are right."""
    from tests.skincal import uneven_rig

    stamped = uneven_rig.wrench_message
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(uneven_rig, "wrench_message", lambda ns, row: stamped(ns - ns % 10**9, row))
        arguments = write_rig_bag(tmp_path / "r", rig)
    code, said, snapshot = imported(arguments)
    assert code == 0
    assert max(errors_mm(snapshot)) < RIGHT_MM
    assert "wrench: most of its stamps are that of the message before; they are placed by their arrival" in said


@pytest.mark.parametrize(("write", "stream"), [*zip(WRITERS, SENSOR_STREAMS, strict=True)])
def test_a_stream_of_nan_is_named_and_leaves_no_session(rig, imported, write, stream, tmp_path):
    rig.rows[stream][:] = np.nan
    code, said, _ = imported(write(tmp_path / "r", rig))
    name = {Stream.WRENCH: "force/torque sensor", Stream.SKIN: "skin", Stream.JOINTS: "joints"}[stream]
    assert code == 2
    assert approved("recording.all_nan", name=name, readings=len(rig.times[stream])) in said
    assert "overlap" not in said
    assert not (tmp_path / "s").exists()


def test_mostly_nan_is_the_first_reason(rig, imported, tmp_path):
    rig.rows[Stream.WRENCH][30:] = np.nan
    code, said, _ = imported(write_tables(tmp_path / "r", rig))
    assert code == 0
    readings = len(rig.times[Stream.WRENCH])
    assert said.count(f"No poke was found: {readings - 30} of the {readings} readings of the force/torque sensor are NaN") == 1


@pytest.mark.parametrize("write", WRITERS)
def test_a_sensor_that_freezes_is_named_with_its_time(rig, imported, write, tmp_path):
    begin, end = 12.13, 20.0
    rows, times = rig.rows[Stream.WRENCH], rig.times[Stream.WRENCH]
    rows[(times >= begin) & (times < end)] = rows[np.flatnonzero(times < begin)[-1]]
    code, said, snapshot = imported(write(tmp_path / "r", rig))
    assert code == 0
    assert max(errors_mm(snapshot)) < RIGHT_MM
    assert approved("recording.frozen", link="wrench", when="from 12.2 to 20.1 s", name="force/torque sensor") in said


def test_a_skin_that_freezes_is_named(rig, imported, tmp_path):
    rig.rows[Stream.SKIN][500:] = rig.rows[Stream.SKIN][499]
    code, said, _ = imported(write_tables(tmp_path / "r", rig))
    assert code == 0
    assert approved("recording.frozen", link="skin", when="from 10.0 s on", name="skin") in said


def test_a_skin_behind_a_threshold_does_not_freeze(rig, imported, tmp_path):
    rows = rig.rows[Stream.SKIN]
    rows[:] = np.where(rows > 30, np.round(rows), 0)
    code, said, _ = imported(write_tables(tmp_path / "r", rig))
    assert code == 0
    assert "repeats" not in said


@pytest.mark.parametrize(("write", "high"), [*zip(WRITERS, [100.0, 255.0, 1.0], strict=True)])
def test_a_binary_skin_is_named_by_every_import(rig, imported, write, high, tmp_path):
    rows = rig.rows[Stream.SKIN]
    rows[:] = np.where(rows > 50, high, 0)
    (rig.scene.path).write_text(rig.scene.path.read_text() + "[contacts]\nresponse_min = 0.5\n")
    code, said, _ = imported(write(tmp_path / "r", rig))
    assert code == 0
    assert approved("recording.binary_skin", high=f"{high:g}") in said
    assert ("skinManager was binarising" in said) == (high != 1.0)


def test_the_window_hears_what_the_command_says(rig, tmp_path):
    rows = rig.rows[Stream.SKIN]
    rows[:] = np.where(rows > 50, 100.0, 0)
    rig.rows[Stream.WRENCH][2000:] = rig.rows[Stream.WRENCH][1999]
    write_tables(tmp_path / "r", rig)
    files = files_of(tmp_path / "r")
    frozen = approved("recording.frozen", link="wrench", when="from 20.0 s on", name="force/torque sensor")
    binary = f"skin: {approved('recording.binary_skin', high='100')}"
    for findings in (
        import_recording(ImportRequest(files, rig.scene.path, "", tmp_path / "s")).findings,
        preview_recording(files).findings,
    ):
        assert frozen in findings
        assert any(each.startswith(binary) for each in findings)


@pytest.mark.parametrize("size", [2, 10])
def test_stampless_frames_in_groups_are_placed_by_their_count(rig, imported, size, tmp_path):
    code, said, snapshot = imported(write_rig_bag(tmp_path / "r", rig, skin_group=size))
    assert code == 0
    assert len(poke_times(snapshot)) == POKES
    assert max(errors_mm(snapshot)) < RIGHT_MM
    assert approved("recording.evenly") in said
    assert "gap" not in said


@pytest.mark.parametrize(("write", "size", "step_s"), [(write_tables, 2, 0.005), (write_logs, 3, 0.001)])
def test_times_of_arrival_in_pairs_are_no_gaps(rig, imported, write, size, step_s, tmp_path):
    """A table of arrivals: its times are all that is known, and the period is not that of a pair."""
    rig.times[Stream.SKIN] = arrive_in_groups(rig.times[Stream.SKIN], size, step_s)
    code, _, snapshot = imported(write(tmp_path / "r", rig))
    assert code == 0
    assert len(poke_times(snapshot)) == POKES
    assert max(errors_mm(snapshot)) < RIGHT_MM


@pytest.mark.parametrize(("stream", "name"), [(Stream.SKIN, "skin"), (Stream.WRENCH, "force/torque sensor")])
def test_a_stream_with_gaps_is_named_and_not_the_noise_of_the_sensor(rig, imported, stream, name, tmp_path):
    """A pause of 0.25 s in every half second: no quiet time is whole."""
    rig.keep(stream, rig.times[stream] % 0.5 < 0.25)
    code, said, snapshot = imported(write_tables(tmp_path / "r", rig))
    assert code == 0
    assert not snapshot.pokes
    assert approved("recording.no_poke_gaps", name=name) in said
    assert "noise" not in said


@pytest.mark.parametrize("kind", ["mcap", "mcap-zstd", "sqlite3", "sqlite3-message"])
def test_two_runs_of_a_simulation_follow_each_other(rig, imported, kind, tmp_path):
    """The recorder's clock is the simulation's, which begins again in a pause between two pokes."""
    code, said, snapshot = imported(write_rig_bag(tmp_path / "r", rig, kind=kind, reset_s=MOVE_S - 0.2))
    assert code == 0
    assert approved("recording.file_order") in said
    assert len(poke_times(snapshot)) >= POKES - 1
    assert max(errors_mm(snapshot)) < RIGHT_MM


@pytest.mark.parametrize("write", WRITERS)
def test_two_runs_that_lie_over_each_other_are_refused(rig, imported, write, tmp_path):
    """Their order is lost: every time has a reading of each run."""
    for stream in rig.times:
        half = len(rig.times[stream]) // 2
        rig.times[stream] = np.repeat(rig.times[stream][:half], 2) + np.tile([0.0, 0.001], half)
        rig.rows[stream] = np.stack([rig.rows[stream][:half], rig.rows[stream][half : 2 * half]], 1).reshape(2 * half, -1)
    code, said, _ = imported(write(tmp_path / "r", rig))
    assert code == 2
    assert approved("recording.mixture") in said
    assert not (tmp_path / "s").exists()

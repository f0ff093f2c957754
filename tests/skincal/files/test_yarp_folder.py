import re
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from skincal.files.importers.timeline import SESSION_START_TIME_NS
from skincal.files.importers.yarp_folder import READ_BLOCK_BYTES
from skincal.model.errors import InputError
from skincal.model.readings import Loss, Stream
from skincal.streams.decoders.auto_detect import make_decoder
from skincal.streams.decoders.yarp_log import LINE_MAX
from skincal.streams.expected_readings import ExpectedReadings
from skincal.streams.intake import Intake
from tests.approved import approved, approved_pattern
from tests.skincal.import_support import read_recording

EPOCH = 1_420_000_000.0
CHANNELS = 24
ONE_STAMP = "Type: Bottle;\nStamp: rx;\n[1.0] /icub/x [connected]\n"
BOTH_STAMPS = "Type: Bottle;\nStamp: tx+rx;\n"


def values_at(time: float) -> tuple[list[float], list[int], list[float]]:
    """Wrench, skin and joints at a time: three pokes of half a second, one a second."""
    phase = time % 1.0
    pressed = phase > 0.5
    poke = int(time)
    force = 8.0 * np.sin(np.pi * (phase - 0.5) / 0.5) if pressed else 0.0
    wrench = [0.25 * poke, -0.5, 3.0 + force, 0.01, -0.02 * force, 0.001]
    skin = [240 - (60 if pressed and channel in (poke, poke + 1) else 0) for channel in range(CHANNELS)]
    return [float(f"{value:.6f}") for value in wrench], skin, [10.0, 20.0, 30.0, 94.0 - 5 * poke, -40.0]


def write_log(folder: Path, rows, info: str | None = ONE_STAMP, rx: float | None = None) -> Path:
    """Write a dumper's folder: rows of (seq, stamp, payload); a second stamp `rx` seconds later where given."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "data.log").open("w", newline="\n") as file:
        for seq, stamp, payload in rows:
            second = "" if rx is None else f"{stamp + rx:.6f} "
            file.write(f"{seq} {stamp:.6f} {second}{payload}\n")
    if info is not None:
        (folder / "info.log").write_text(info)
    return folder


def text(values) -> str:
    return " ".join(map(str, values))


def recording(folder: Path, seconds: float = 3.0, rates=(100, 50, 20), set_back=lambda _: 0.0, **options) -> dict[str, Path]:
    """Write wrench, skin and joints logs of the same pokes, by a clock that is `set_back` by some seconds at a time."""
    folders: dict[str, Path] = {}
    for index, (name, rate) in enumerate(zip(("wrench", "skin", "joints"), rates, strict=True)):
        times = np.arange(int(seconds * rate)) / rate
        rows = [(seq, EPOCH + time - set_back(time), text(values_at(time)[index])) for seq, time in enumerate(times)]
        folders[name] = write_log(folder / name, rows, **options)
    return folders


def decode(links, chunks):
    """Feed chunks to the decoders that the links name; return batches by link, and losses."""
    decoders = {link.name: make_decoder(link.format, CHANNELS, link.carries) for link in links}
    batches: dict[str, list] = {link.name: [] for link in links}
    for chunk in chunks:
        batches[chunk.link] += decoders[chunk.link].feed(chunk.data)
    return batches, {name: decoder.counts for name, decoder in decoders.items()}


@pytest.mark.parametrize(
    ("options", "format_"),
    [
        ({}, "yarp"),
        ({"info": None}, "yarp"),
        ({"info": BOTH_STAMPS, "rx": 0.003}, "yarp-tx-rx"),
        ({"info": "Type: Bottle;\n", "rx": 0.003}, "yarp-tx-rx"),
        ({"info": None, "rx": 0.003}, "yarp-tx-rx"),
    ],
    ids=["rx", "no info", "tx+rx", "old info, two stamps", "no info, two stamps"],
)
def test_a_recording_decodes_to_what_was_logged(tmp_path, options, format_):
    folders = recording(tmp_path, **options)
    links, chunks, findings = read_recording("yarp", folders["wrench"], folders["skin"], folders["joints"])
    assert [(link.name, link.carries, link.format) for link in links] == [
        (stream.value, (stream,), format_) for stream in (Stream.WRENCH, Stream.SKIN, Stream.JOINTS)
    ]
    batches, counts = decode(links, chunks)
    assert not any(counts.values())
    for index, (name, rate) in enumerate((("wrench", 100), ("skin", 50), ("joints", 20))):
        times = np.arange(3 * rate) / rate
        wanted = np.array([values_at(time)[index] for time in times], dtype=float)
        device_s = np.concatenate([batch.device_s for batch in batches[name]])
        np.testing.assert_allclose(device_s - EPOCH, times, atol=1e-6)
        got = np.vstack([batch.values for batch in batches[name]])
        np.testing.assert_allclose(got, np.radians(wanted) if name == "joints" else wanted, rtol=1e-15)
    assert findings[0] == approved("csv_log.rate", link="wrench", lines=300, seconds=3.0, rate=100)
    assert len(findings) == 3


def test_chunks_are_whole_lines_and_never_run_backwards(tmp_path):
    folders = recording(tmp_path, info=BOTH_STAMPS, rx=0.5)
    _, chunks, _ = read_recording("yarp", folders["wrench"], folders["skin"])
    items = list(chunks)
    assert all(item.data.endswith(b"\n") for item in items)
    assert sum(item.data.count(b"\n") for item in items) == 450
    times = [item.host_ns for item in items]
    assert times == sorted(times)
    assert times[0] == SESSION_START_TIME_NS
    # By the receiver's clock: the first wrench alone, then those 10 to 90 ms after it.
    assert [item.host_ns for item in items if item.link == "wrench"][1] == SESSION_START_TIME_NS + 90_000_000


def samples_of(folders) -> list:
    links, chunks, _ = read_recording("yarp", folders["wrench"], folders["skin"], folders["joints"])
    intake = Intake(ExpectedReadings(CHANNELS), links)
    return [sample for chunk in chunks for sample in intake.feed(chunk)]


def test_a_log_of_pokes_pairs_each_frame_with_its_wrench(tmp_path):
    samples = samples_of(recording(tmp_path))
    assert len(samples) > 140
    origin = SESSION_START_TIME_NS * 1e-9
    for sample in samples[5:]:
        time = sample.host_s - origin
        pressed = (sample.skin < 240).any()
        assert sample.readings == 2
        # The mean of the two readings of the frame's 20 ms: its stamp and 10 ms before.
        wanted = np.mean([values_at(round(t, 2))[0] for t in (time, time - 0.01)], axis=0)
        np.testing.assert_allclose(sample.wrench, wanted, atol=1e-9)
        assert pressed == (round(time, 2) % 1.0 > 0.5)
        assert sample.angles is not None


def lines_of(folder: Path) -> list[str]:
    return (folder / "data.log").read_text().splitlines()


def without_sender_times(folder, lines=None):
    """Make the sender's stamps 0, as the dumper writes them of a sender without an envelope; of all lines, or of some."""
    path = folder / "data.log"
    words = [line.split(" ", 2) for line in path.read_text().splitlines()]
    for index in range(len(words)) if lines is None else lines:
        words[index][:2] = "-1", "0.000000"
    path.write_text("".join(" ".join(line) + "\n" for line in words))


@pytest.mark.parametrize("info", [BOTH_STAMPS, None], ids=["by info.log", "by the lines"])
@pytest.mark.parametrize(
    "which", [None, range(5), range(40, 150, 3), [149]], ids=["no line", "not at first", "not always", "the last"]
)
def test_lines_without_a_time_of_the_sender_are_placed_by_the_receivers(tmp_path, info, which):
    """Where the sender's clock is 4 s ahead, too: one log is on one clock."""
    folders = recording(tmp_path, rx=-4.0, info=info)
    expected = samples_of(folders)
    for folder in folders.values():
        without_sender_times(folder, None if which is None else [line for line in which if line < 60 or "skin" in folder.name])
    links, chunks, findings = read_recording("yarp", folders["wrench"], folders["skin"], folders["joints"])
    assert not any(sum(counts.values()) for counts in decode(links, chunks)[1].values())
    count = 150 if which is None else len(which)
    assert links[1].format == "yarp-rx"
    said = approved("yarp_log.no_sender_time", count=count, lines=150)
    assert [finding for finding in findings if "sender" in finding and "skin" in finding] == [said]
    samples = samples_of(folders)
    assert len(samples) == len(expected) > 140
    for sample, other in zip(samples, expected, strict=True):
        assert sample.host_s == pytest.approx(other.host_s, abs=1e-6)
        np.testing.assert_array_equal(sample.skin, other.skin)


@pytest.mark.parametrize("rx", [0.0, 0.004])
def test_a_log_by_the_senders_time_that_it_never_gave_has_the_receivers_as_well(tmp_path, rx):
    """yarpdatadumper --txTime writes both stamps where a message has no envelope, though info.log says tx alone."""
    folders = recording(tmp_path, rx=rx, info="Type: Bottle;\nStamp: rx;\n")
    (folders["skin"] / "info.log").write_text("Type: Bottle;\nStamp: tx;\n")
    expected = samples_of(recording(tmp_path / "right"))
    without_sender_times(folders["skin"])
    for name in ("wrench", "joints"):
        folders[name] = tmp_path / "right" / name
    samples = samples_of(folders)
    assert len(samples) == len(expected) > 140
    for sample, other in zip(samples, expected, strict=True):
        assert sample.host_s == pytest.approx(other.host_s + rx, abs=1e-6)
        np.testing.assert_array_equal(sample.skin, other.skin)


@pytest.mark.parametrize(
    "word", ["-nan.0", "nan.0", "-nan", "nan", "-nan(ind)", "-nan(ind).0", "1.#QNAN", "-1.#IND", "-1.#IND00"]
)
@pytest.mark.parametrize("form", ["{}", "({})"], ids=["plain", "in a list"])
@pytest.mark.parametrize("step", [1, 7], ids=["each line", "some lines"])
def test_every_text_of_a_number_that_is_none_is_a_dead_taxel(tmp_path, word, form, step):
    """YARP writes a negative NaN, 0/0 on x86, as -nan.0; C libraries of Windows have others."""
    folders = recording(tmp_path)
    rows = [
        [int(seq), float(stamp), payload] for seq, stamp, payload in (line.split(" ", 2) for line in lines_of(folders["skin"]))
    ]
    for k, row in enumerate(rows):
        words = row[2].split()
        row[2] = form.format(" ".join([word, *words[1:]] if k % step == 0 else words))
    write_log(folders["skin"], rows)
    links, chunks, _ = read_recording("yarp", folders["wrench"], folders["skin"])
    batches, counts = decode(links, chunks)
    values = np.vstack([batch.values for batch in batches["skin"]])
    assert counts["skin"] == {Loss.NOT_A_NUMBER: len(range(0, 150, step))}
    assert np.isnan(values[:, 0]).tolist() == [k % step == 0 for k in range(150)]
    np.testing.assert_array_equal(values[:, 1:], [values_at(k / 50)[1][1:] for k in range(150)])


def test_an_infinite_value_is_no_number_and_words_are_still_none(tmp_path):
    folder = write_log(
        tmp_path / "skin", [(0, EPOCH, "1 inf.0 -1.#INF"), (1, EPOCH + 0.1, "1 nano 2"), (2, EPOCH + 0.2, "1 2 3")]
    )
    wrench = recording(tmp_path / "other")["wrench"]
    links, chunks, _ = read_recording("yarp", wrench, folder)
    decoder = make_decoder("yarp", 3, (Stream.SKIN,))
    values = [batch.values for chunk in chunks if chunk.link == "skin" for batch in decoder.feed(chunk.data)]
    assert links[1].format == "yarp"
    assert decoder.counts == {Loss.NOT_A_NUMBER: 1, Loss.UNREADABLE: 1}
    np.testing.assert_array_equal(np.vstack(values), [[1, np.nan, np.nan], [1, 2, 3]])


def test_a_log_of_a_sender_without_times_and_of_nothing_else_is_refused(tmp_path):
    folders = recording(tmp_path, info="Type: Bottle;\nStamp: tx;\n")
    without_sender_times(folders["skin"])
    with pytest.raises(InputError, match=approved_pattern("yarp_log.no_time_at_all")):
        read_recording("yarp", folders["wrench"], folders["skin"])


def test_lines_that_travel_together_give_the_samples_of_lines_alone(tmp_path, monkeypatch):
    folders = recording(tmp_path, rates=(500, 50, 100), info=BOTH_STAMPS, rx=0.002)
    samples = samples_of(folders)
    monkeypatch.setattr("skincal.files.importers.timeline.CHUNK_MAX_LINES", 1)
    alone = samples_of(folders)
    # The last frames differ: they wait for a wrench, and nothing comes any more.
    assert len(alone) - 3 <= len(samples) <= len(alone)
    for sample, other in zip(samples, alone, strict=False):
        assert sample.host_s == pytest.approx(other.host_s, abs=1e-6)
        np.testing.assert_array_equal(sample.skin, other.skin)
        np.testing.assert_array_equal(sample.wrench, other.wrench)
        assert sample.readings == other.readings
        # Of angles of the frame's very instant, those that come before it count: with lines alone they come after it.
        time = sample.host_s - SESSION_START_TIME_NS * 1e-9
        if abs(time - round(time)) > 1e-3:
            np.testing.assert_array_equal(sample.angles, other.angles)


def test_one_stamp_written_wrong_costs_no_more_than_its_own_frames(tmp_path):
    folders = recording(tmp_path)
    for name, line in (("wrench", 120), ("skin", 90)):
        path = folders[name] / "data.log"
        lines = path.read_text().splitlines()
        lines[line] = lines[line].replace(" 1420000", " 9420000", 1)
        path.write_text("\n".join(lines) + "\n")
    assert len(samples_of(folders)) >= 145


@pytest.mark.parametrize("stamp", ["1e30", "1e308", "-1e12", "nan"])
def test_a_stamp_that_is_no_time_is_no_record(tmp_path, stamp):
    folders = recording(tmp_path)
    path = folders["wrench"] / "data.log"
    lines = path.read_text().splitlines()
    lines[50] = f"50 {stamp} 1 2 3 4 5 6"
    path.write_text("\n".join(lines) + "\n")
    links, chunks, findings = read_recording("yarp", folders["wrench"], folders["skin"])
    _, counts = decode(links, chunks)
    assert counts["wrench"][Loss.UNREADABLE] == 1
    assert approved("yarp_log.odd_line", link="wrench", count=1) in findings


def test_the_end_of_a_line_that_is_too_long_is_no_record(tmp_path):
    folders = recording(tmp_path)
    path = folders["skin"] / "data.log"
    lines = path.read_text().splitlines()
    lines.insert(50, "240 241 " * (LINE_MAX // 8 + 100))
    path.write_text("\n".join(lines) + "\n")
    links, chunks, findings = read_recording("yarp", folders["wrench"], folders["skin"])
    batches, counts = decode(links, chunks)
    assert sum(len(batch.seq) for batch in batches["skin"]) == 150
    assert counts["skin"] == {Loss.UNREADABLE: 1}
    assert approved("yarp_log.odd_line", link="skin", count=1) in findings


def test_a_clock_set_back_in_all_logs_loses_nothing(tmp_path):
    folders = recording(tmp_path, set_back=lambda time: 3600.0 if time > 1.303 else 0.0)
    _, chunks, findings = read_recording("yarp", folders["wrench"], folders["skin"], folders["joints"])
    rates, lines = {"wrench": 100, "skin": 50, "joints": 20}, dict.fromkeys(folders, 0)
    for chunk in chunks:
        lines[chunk.link] += chunk.data.count(b"\n")
        # One clock, so one shift: the same instant as without the jump, to within an interval of the first file.
        assert (chunk.host_ns - SESSION_START_TIME_NS) * 1e-9 == pytest.approx(
            (lines[chunk.link] - 1) / rates[chunk.link], abs=1e-5
        )
    assert lines == {name: 3 * rate for name, rate in rates.items()}
    assert sum(approved("yarp_log.clock_back", count=1, seconds=3600.0) in finding for finding in findings) == 3
    assert len(samples_of(folders)) > 120


def test_messages_out_of_order_and_gaps_are_said_and_kept(tmp_path):
    times = [k / 100 for k in range(100)]
    times[40], times[41] = times[41], times[40]
    rows = [(k, EPOCH + time + (2.0 if k >= 60 else 0.0), text(values_at(0.0)[0])) for k, time in enumerate(times)]
    wrench = write_log(tmp_path / "w", rows)
    skin = recording(tmp_path)["skin"]
    _, chunks, findings = read_recording("yarp", wrench, skin)
    placed = {int(line.split()[0]): c.host_ns for c in chunks if c.link == "wrench" for line in c.data.splitlines()}
    assert list(placed) == list(range(100))
    assert placed[60] - placed[59] == 2_010_000_000
    assert approved("yarp_log.gap", link="wrench", count=1, seconds=2.01) in findings
    assert approved("yarp_log.stamp_back", link="wrench", count=1) in findings


def test_an_early_gap_is_said_too(tmp_path):
    rows = [(k, EPOCH + k / 100 + (1.0 if k >= 3 else 0.0), "1 2 3 4 5 6") for k in range(2000)]
    _, _, findings = read_recording("yarp", write_log(tmp_path / "w", rows), recording(tmp_path)["skin"])
    assert approved("yarp_log.gap", link="wrench", count=1, seconds=1.01) in findings


def test_empty_unreadable_and_cut_lines_are_counted(tmp_path):
    folders = recording(tmp_path)
    path = folders["wrench"] / "data.log"
    lines = path.read_text().splitlines()
    lines[10] = " ".join(lines[10].split()[:2]) + " "
    lines[20] = "garbage"
    lines[30] = lines[30] + " 7"
    path.write_text("Type: Bottle;\n" + "\n".join(lines[:-1]) + "\n\n" + lines[-1][:-4])
    links, chunks, findings = read_recording("yarp", folders["wrench"], folders["skin"])
    batches, counts = decode(links, chunks)
    assert sum(len(batch.seq) for batch in batches["wrench"]) == 296
    # The unreadable line is also a number that is missing.
    assert counts["wrench"] == {Loss.BAD_WIDTH: 2, Loss.UNREADABLE: 1, Loss.MISSING: 1}
    assert [finding for finding in findings if finding.startswith("wrench")] == [
        approved("csv_log.rate", link="wrench", lines=298, seconds=3.0, rate=100),
        approved("yarp_log.odd_width", link="wrench", count=1, width=6),
        approved("yarp_log.empty_line", link="wrench", count=1),
        approved("yarp_log.odd_line", link="wrench", count=1),
        approved("yarp_log.cut_line", link="wrench"),
    ]


def test_the_new_ports_structure_is_read(tmp_path):
    rows = [
        (k, EPOCH + k / 100, f"() () () () () (((1 2 3 4 5 {k}) 1.5) ((9 9 9 9 9 9) 1)) () () () () () ()") for k in range(300)
    ]
    links, chunks, findings = read_recording("yarp", write_log(tmp_path / "w", rows), recording(tmp_path)["skin"])
    batches, counts = decode(links, chunks)
    np.testing.assert_array_equal(np.vstack([b.values for b in batches["wrench"]])[:, 5], np.arange(300))
    assert not counts["wrench"]
    assert approved("yarp_log.two_sensors", link="wrench", count=2) in findings


def test_logs_placed_by_different_clocks_are_said(tmp_path):
    wrench = recording(tmp_path / "a", info="Type: Bottle;\nStamp: tx;\n")["wrench"]
    skin = recording(tmp_path / "b", info=BOTH_STAMPS, rx=0.001)["skin"]
    _, _, findings = read_recording("yarp", wrench, skin)
    assert any(approved("yarp_log.two_clocks") in finding for finding in findings)


def test_the_log_is_found_by_file_folder_and_numbered_folder(tmp_path):
    folders = recording(tmp_path)
    _, _, findings = read_recording("yarp", folders["wrench"] / "data.log", folders["skin"])
    assert len(findings) == 2
    numbered = folders["wrench"].rename(tmp_path / "right_arm_00001")
    _, chunks, findings = read_recording("yarp", tmp_path / "right_arm", folders["skin"])
    assert approved("yarp_log.only_log", folder="right_arm_00001") in findings[0]
    assert any(chunk.link == "wrench" for chunk in chunks)
    recording(tmp_path)["wrench"].rename(tmp_path / "right_arm_00002")
    with pytest.raises(
        InputError, match=approved_pattern("yarp_log.several_folders", names=f"{numbered}, {tmp_path / 'right_arm_00002'}")
    ):
        read_recording("yarp", tmp_path / "right_arm", folders["skin"])
    numbered.rename(tmp_path / "right_arm")
    _, _, findings = read_recording("yarp", tmp_path / "right_arm", folders["skin"])
    assert approved("yarp_log.another_folder", folder="right_arm_00002") in findings[0]
    (tmp_path / "all").mkdir()
    (tmp_path / "right_arm").rename(tmp_path / "all" / "analog")
    _, _, findings = read_recording("yarp", tmp_path / "all", folders["skin"])
    assert approved("yarp_log.only_log", folder="analog") in findings[0]


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda _: None, approved("yarp_log.no_folder")),
        (lambda folder: folder.mkdir(), approved("yarp_log.no_log")),
        (lambda folder: write_log(folder, []), approved("yarp_log.empty")),
        (lambda folder: write_log(folder, [("a", 1.0, "b")] * 3), approved("yarp_log.no_line_fits", lines=3)),
        (
            lambda folder: write_log(folder, [(1, 1.0, "f.ppm")], info="Type: Image:ppm;\n"),
            approved("yarp_log.wrong_type", type="Image:ppm"),
        ),
        (
            lambda folder: write_log(folder, [(1, 1.0, "1 2")], info="Stamp: gps;\n"),
            approved("yarp_log.wrong_stamp", stamp="gps"),
        ),
        (lambda folder: write_log(folder, [(1, 1.0, text(range(384)))]), approved("yarp_log.wrong_values", values=384)),
        (lambda folder: write_log(folder, [(1, EPOCH - 900.0, text(range(6)))]), approved("recording.other_time")),
    ],
    ids=["no folder", "no log", "empty", "not a log", "images", "stamp", "swapped", "another day"],
)
def test_wrong_input_is_said(tmp_path, make, said):
    skin = recording(tmp_path)["skin"]
    make(tmp_path / "given")
    with pytest.raises(InputError, match=re.escape(said)):
        read_recording("yarp", tmp_path / "given", skin)


def memory_of_reading(folder, seconds):
    """Return the most bytes that reading a recording of so many seconds takes, the files not counted."""
    folders = recording(folder, seconds)
    tracemalloc.start()
    try:
        _, chunks, _ = read_recording("yarp", folders["wrench"], folders["skin"], folders["joints"])
        count = sum(chunk.data.count(b"\n") for chunk in chunks)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert count == seconds * 170
    return peak


def test_a_long_log_takes_the_memory_of_its_stamps_alone(tmp_path):
    short, long = (memory_of_reading(tmp_path / str(seconds), seconds) for seconds in (120, 240))
    assert long - short < 8 * 8 * 170 * 120, (short, long)
    # Some blocks of each of the three files.
    assert short < 48 * READ_BLOCK_BYTES, short

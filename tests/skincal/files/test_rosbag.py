"""Bags of ROS 1 and ROS 2 become sessions: as the same streams in tables do, or with a sentence that says why not."""

import contextlib
import json
import os
import subprocess
from collections import Counter
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import skincal
from skincal.cli import main
from skincal.files.importers.bag_reader import Bag
from skincal.files.importers.preview import RecordingFiles, guess_streams, preview_recording
from skincal.files.importers.registry import RecordedPlace, StoppedError, importer_of
from skincal.files.importers.tape import NumberFile, Tape
from skincal.journal.reader import SessionLog
from skincal.model.errors import InputError
from skincal.model.readings import SENSOR_STREAMS, Chunk, Loss, Stream
from skincal.model.scene import load_scene, resource
from skincal.session.importing import ImportRequest, import_recording
from skincal.session.replay import load
from skincal.streams.decoders.auto_detect import LinkDecoder
from skincal.streams.decoders.records import RecordsDecoder, pack_records
from tests.skincal.ros_support import (
    BAG_KINDS,
    JOINT_NAMES,
    JOINTS_TYPE,
    SKIN_TYPE,
    WRENCH_TYPE,
    BagFile,
    joints_message,
    skin_message,
    wrench_message,
)

SECOND_NS = 10**9
START_NS = 1_700_000_000 * SECOND_NS
DELAY_NS = 2_000_000
"""From a message's stamp to its arrival at the recorder."""
SAMPLE_S = 50
LAB_TYPE = "lab_msgs/msg/TaxelData"
LAB_DEFINITION = "std_msgs/Header header\nuint8 cdc_length\nfloat32[] cdc\n"


@cache
def sample_streams():
    """Times (n,) ns and values (n, width) of the first 50 s of the shipped simulated session; joints are radians."""
    log = SessionLog(resource("sessions/sample"))
    decoders = {link.name: LinkDecoder(link.format, None, link.carries) for link in log.links}
    times, rows = {stream: [] for stream in SENSOR_STREAMS}, {stream: [] for stream in SENSOR_STREAMS}
    for item in log.items():
        if times[Stream.SKIN] and item.host_ns > times[Stream.SKIN][0] + (SAMPLE_S + 1) * SECOND_NS:
            break
        for host_ns, batch in decoders[item.link].feed(item.data, item.host_ns) if isinstance(item, Chunk) else ():
            times[batch.stream] += [host_ns // 1000 * 1000] * len(batch.values)
            rows[batch.stream] += batch.values.tolist()
    end_ns = times[Stream.SKIN][0] + SAMPLE_S * SECOND_NS
    counts = {stream: sum(time < end_ns for time in times[stream]) for stream in SENSOR_STREAMS}
    return {stream: (times[stream][:count], np.array(rows[stream][:count])) for stream, count in counts.items()}


def write_sample(path, kind):
    """Write the sample session as a bag; the skin has no header."""
    streams = sample_streams()
    with BagFile(path, kind) as bag:
        for stamp_ns, row in zip(*streams[Stream.WRENCH], strict=True):
            bag.add("/ft/wrench", WRENCH_TYPE, stamp_ns + 1, wrench_message(stamp_ns, row))
        for stamp_ns, row in zip(*streams[Stream.JOINTS], strict=True):
            # Another order and more joints: the scene's are found by their names.
            bag.add("/joint_states", JOINTS_TYPE, stamp_ns + 1, joints_message(stamp_ns, row))
        for stamp_ns, row in zip(*streams[Stream.SKIN], strict=True):
            bag.add("/skin", SKIN_TYPE, stamp_ns, skin_message(row))
    return bag.path


def write_sample_tables(folder):
    heads = {Stream.WRENCH: ["fx", "fy", "fz", "mx", "my", "mz"], Stream.JOINTS: [f"{name}_rad" for name in JOINT_NAMES]}
    for stream, (times, rows) in sample_streams().items():
        names = heads.get(stream) or [f"t{channel}" for channel in range(rows.shape[1])]
        lines = (f"{ns * 1e-9!r},{','.join(map(repr, row))}\n" for ns, row in zip(times, rows.tolist(), strict=True))
        (folder / f"{stream.value}.csv").write_text(f"t_s,{','.join(names)}\n{''.join(lines)}")
    return [part for stream in SENSOR_STREAMS for part in (f"--{stream.value}", str(folder / f"{stream.value}.csv"))]


def import_sample(arguments, out, capsys):
    """Import it for the forearm: results as JSON, and the positions by method and channel."""
    capsys.readouterr()
    assert main(["import", *arguments, "--scene", "icub-forearm", "--out", str(out), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    found = load(out).snapshot().estimates
    return result, {(method, each.channel): each.position for method, of in found.items() for each in of}


def test_a_bag_gives_the_estimates_of_the_same_streams_in_tables(tmp_path, capsys):
    result, expected = import_sample(["csv", *write_sample_tables(tmp_path)], tmp_path / "tables", capsys)
    assert sum(position is not None for position in expected.values()) > 60
    bag = write_sample(tmp_path / "bag", "mcap")
    other, found = import_sample(["rosbag", str(bag)], tmp_path / "from-bag", capsys)
    for name in ("pokes", "accepted", "frames_without_wrench"):
        assert other[name] == result[name]
    assert found.keys() == expected.keys()
    for key, position in expected.items():
        assert (position is None) == (found[key] is None)
        if position is not None:
            np.testing.assert_allclose(found[key], position, atol=1e-9)
    session = skincal.read_bag(skincal.Scene.load("icub-forearm"), bag)
    same = session.taxels("surface").compare(f"{tmp_path / 'from-bag'}:surface")
    assert (len(same.channel) > 20, same.worst) == (True, 0.0)
    assert any("/skin" in sentence for sentence in session.findings)
    with pytest.raises(InputError, match="has no topic /nowhere"):
        skincal.read_bag(session.scene, bag, skin="/nowhere")


# ------------------------------------------------------------------ small bags


def rows_of(count, width, scale=1.0):
    return scale * np.arange(count * width, dtype=float).reshape(count, width)


def write_small(path, kind="mcap", seconds=4.0, **options):
    """Write a bag of 100 wrenches, 50 skin frames and 20 joint states a second."""
    start_ns, skin_late_ns = options.get("start_ns", START_NS), round(1e9 * options.get("skin_late_s", 0.0))
    messages = [
        (start_ns + round(k * 1e9 / rate), topic, k)
        for topic, rate in (("/ft/wrench", 100), ("/skin", 50), ("/joint_states", 20))
        for k in range(round(seconds * rate))
    ]
    with BagFile(path, kind) as bag:
        for ns, topic, k in sorted(messages):
            stamp_ns = ns + round(1e9 * options.get("stamp_off_s", 0.0))
            if topic == "/ft/wrench":
                bag.add(topic, WRENCH_TYPE, ns + DELAY_NS, wrench_message(stamp_ns, [k, k + 0.5, -k, 0.1, 0.2, 0.3]))
            elif topic == "/joint_states":
                bag.add(topic, JOINTS_TYPE, ns + DELAY_NS, joints_message(stamp_ns, np.arange(5) + 0.01 * k))
            elif ns - start_ns >= skin_late_ns:
                bag.add(topic, SKIN_TYPE, ns + DELAY_NS, skin_message(np.arange(24) + k))
    return bag.path


def open_bag(path, wrench="/ft/wrench", skin="/skin", joints="", names=(), go_on=lambda _: True):
    texts = {Stream.WRENCH: wrench, Stream.SKIN: skin, Stream.JOINTS: joints}
    places = {stream: RecordedPlace(path, text) for stream, text in texts.items() if text}
    return importer_of(path).open_recording(places, names, go_on)


def readings(opened):
    """Times and values of each stream, and the losses."""
    decoders = {link.name: LinkDecoder(link.format, None, link.carries) for link in opened.links}
    batches = {name: [] for name in decoders}
    for chunk in opened.chunks():
        batches[chunk.link] += [batch for _, batch in decoders[chunk.link].feed(chunk.data, chunk.host_ns)]
    values = {
        name: (np.concatenate([each.device_s for each in found]), np.concatenate([each.values for each in found]))
        for name, found in batches.items()
        if found
    }
    return values, {name: dict(decoder.current.counts) for name, decoder in decoders.items() if decoder.current.counts}


@pytest.mark.parametrize("kind", BAG_KINDS)
def test_every_storage_and_compression_has_the_same_readings(tmp_path, kind):
    path = write_small(tmp_path / "bag", kind)
    opened = open_bag(path, joints="/joint_states", names=("j3", "", "j1"))
    values, losses = readings(opened)
    assert losses == {}
    times, wrenches = values["wrench"]
    np.testing.assert_allclose(times, START_NS * 1e-9 + np.arange(400) / 100, atol=5e-7)
    assert wrenches[7].tolist() == [7, 7.5, -7, 0.1, 0.2, 0.3]
    times, skin = values["skin"]
    np.testing.assert_allclose(times, (START_NS + DELAY_NS) * 1e-9 + np.arange(200) / 50, atol=5e-7)
    assert np.array_equal(skin, np.arange(24) + np.arange(200)[:, None])
    np.testing.assert_allclose(values["joints"][1][4], [3.04, 0.0, 1.04])
    found = guess_streams([path])
    assert found == RecordingFiles(*(RecordedPlace(path, topic) for topic in ("/ft/wrench", "/skin", "/joint_states")))


def test_files_of_a_killed_recorder_are_read_without_metadata(tmp_path):
    path = write_small(tmp_path / "bag", "mcap")
    (path / "metadata.yaml").unlink()
    expected, _ = readings(open_bag(write_small(tmp_path / "whole", "mcap")))
    opened = open_bag(path)
    assert np.array_equal(readings(opened)[0]["wrench"][1], expected["wrench"][1])
    assert any("no metadata.yaml" in sentence for sentence in opened.findings)
    assert guess_streams([path]).wrench == RecordedPlace(path, "/ft/wrench")


def test_patches_and_own_types_make_one_skin(tmp_path):
    with BagFile(tmp_path / "bag", "mcap", {LAB_TYPE: LAB_DEFINITION}) as bag:
        for k in range(100):
            ns = START_NS + k * 10_000_000
            bag.add("/ft", WRENCH_TYPE, ns, wrench_message(ns, [k, 0, 0, 0, 0, 0]))
            lab = {"header": {"stamp": {"sec": ns // SECOND_NS, "nanosec": ns % SECOND_NS}, "frame_id": ""}, "cdc_length": 3}
            bag.add("/b", LAB_TYPE, ns, lab | {"cdc": [k, k + 1, k + 2]})
            if k % 2:
                bag.add("/a", LAB_TYPE, ns + 1000, lab | {"cdc": [-k, 0.5]})
    opened = open_bag(bag.path, "/ft", "/a+/b")
    frames = readings(opened)[0]["skin"][1]
    assert len(frames) == 50
    assert frames[3].tolist() == [-7, 0.5, 7, 8, 9]
    assert any("49 messages of /b left out" in each or "50 messages of /b left out" in each for each in opened.findings)
    one = readings(open_bag(bag.path, "/ft", "/b?field=cdc[1]"))[0]["skin"][1]
    assert one[:3].tolist() == [[1], [2], [3]]
    assert guess_streams([bag.path], 5).skin == RecordedPlace(bag.path, "/a+/b")
    assert guess_streams([bag.path], 3).skin == RecordedPlace(bag.path, "/b")


def test_a_lost_message_of_a_patch_costs_one_frame(tmp_path):
    with BagFile(tmp_path / "bag", "mcap", {LAB_TYPE: LAB_DEFINITION}) as bag:
        for k in range(50):
            ns = START_NS + k * 20_000_000
            bag.add("/ft", WRENCH_TYPE, ns, wrench_message(ns, [k, 0, 0, 0, 0, 0]))
            lab = {"header": {"stamp": {"sec": ns // SECOND_NS, "nanosec": ns % SECOND_NS}, "frame_id": ""}, "cdc_length": 1}
            for topic in ("/a", "/b"):
                if (topic, k) != ("/a", 20):
                    bag.add(topic, LAB_TYPE, ns + 1000, lab | {"cdc": [k]})
    frames = readings(open_bag(bag.path, "/ft", "/a+/b"))[0]["skin"][1]
    assert len(frames) == 49
    assert (frames[:, 0] == frames[:, 1]).all()


def test_types_without_a_definition_in_the_bag_come_from_their_file(tmp_path):
    path = write_small(tmp_path / "bag", "sqlite3")
    with BagFile(tmp_path / "lab", "sqlite3", {LAB_TYPE: LAB_DEFINITION}) as bag:
        for k in range(50):
            ns = START_NS + k * 20_000_000
            bag.add("/ft", WRENCH_TYPE, ns, wrench_message(ns, [k, 0, 0, 0, 0, 0]))
            bag.add("/skin", LAB_TYPE, ns, {"header": {"stamp": {}, "frame_id": ""}, "cdc_length": 2, "cdc": [k, -k]})
    # Recorders before ROS 2 Iron kept no definitions.
    for each in (path, bag.path):
        database = next(each.glob("*.db3"))
        subprocess.run(
            ["python3", "-c", "import sqlite3,sys;c=sqlite3.connect(sys.argv[1]);c.execute('drop table schema');"
             "c.execute('drop table message_definitions');c.commit()", str(database)], check=True
        )  # fmt: skip
    assert len(readings(open_bag(path))[0]["wrench"][0]) == 400
    with pytest.raises(InputError, match=r"/skin: .*lab_msgs/msg/TaxelData has no definition here; add its .msg file"):
        open_bag(bag.path, "/ft", "/skin")
    with pytest.raises(InputError, match="No recording of the skin"):
        guess_streams([bag.path]).open()
    definition = tmp_path / "TaxelData.msg"
    definition.write_text(LAB_DEFINITION)
    assert readings(open_bag(bag.path, "/ft", f"/skin?msg={definition}"))[0]["skin"][1][3].tolist() == [3, -3]


# ------------------------------------------------------------------ times


@pytest.mark.parametrize(
    ("offset_s", "skin", "words"),
    [
        (0.0, "/skin", "skin: its messages have no stamp; they are placed by their arrival"),
        (-0.3, "/skin", "wrench: its clock differs from the recorder's by -0.302 s; this was corrected"),
        (-0.3, "/joint_states?field=position", "wrench: it is placed by the stamps of its sender, -0.302 s"),
        (-7200.0, "/skin", "wrench: its clock differs from the recorder's by -7200.002 s; this was corrected"),
        (-7200.0, "/joint_states?field=position", "wrench: it is placed by the stamps of its sender, -7200.002 s"),
    ],
)
def test_clocks_of_other_machines_are_found(tmp_path, offset_s, skin, words):
    opened = open_bag(write_small(tmp_path / "bag", stamp_off_s=offset_s), skin=skin)
    values, _ = readings(opened)
    begin = START_NS * 1e-9 + (offset_s if skin != "/skin" else 0.0)
    assert values["wrench"][0][0] == pytest.approx(begin, abs=0.0021)
    assert np.ptp(np.diff(values["wrench"][0])) < 1e-6
    assert any(sentence.startswith(words) for sentence in opened.findings)


def test_stamps_of_0_are_no_stamps_and_unsteady_clocks_are_refused(tmp_path):
    with BagFile(tmp_path / "bag", "mcap") as bag:
        for k in range(300):
            ns = START_NS + k * 10_000_000
            bag.add("/none", WRENCH_TYPE, ns, wrench_message(0, [k, 0, 0, 0, 0, 0]))
            bag.add("/half", WRENCH_TYPE, ns, wrench_message(ns if k % 2 else 0, [k, 0, 0, 0, 0, 0]))
            # A simulation at half speed.
            bag.add("/slow", WRENCH_TYPE, ns, wrench_message(1 + k * 5_000_000, [k, 0, 0, 0, 0, 0]))
            bag.add("/skin", SKIN_TYPE, ns, skin_message([k]))
    times = START_NS * 1e-9 + np.arange(300) * 0.01
    for topic, words in (
        ("/none", "wrench: its messages have no stamp"),
        ("/half", "wrench: 150 messages without a stamp: placed by the arrival"),
        ("/slow", "wrench: its stamps differ from the arrival by"),
    ):
        opened = open_bag(bag.path, topic)
        np.testing.assert_allclose(readings(opened)[0]["wrench"][0], times, atol=1e-6)
        assert any(sentence.startswith(words) for sentence in opened.findings), opened.findings


def test_clock_jumps_and_late_topics_are_reported(tmp_path):
    with BagFile(tmp_path / "bag", "mcap") as bag:
        for k in range(1000):
            ns = START_NS + k * 10_000_000 - (3 * SECOND_NS if k >= 600 else 0)
            bag.add("/ft/wrench", WRENCH_TYPE, START_NS + k * 10_000_000, wrench_message(ns, [k, 0, 0, 0, 0, 0]))
    assert any(
        "the clock was set back 1 time (3.0" in each for each in open_bag(bag.path, skin="/ft/wrench?field=wrench").findings
    )
    late = open_bag(write_small(tmp_path / "late", seconds=8.0, skin_late_s=5.0)).findings
    assert any(each.startswith("skin: starts 5.0 s after the first stream") for each in late)


# ------------------------------------------------------------------ what cannot be imported


def test_wrong_topics_are_named(tmp_path):
    path = write_small(tmp_path / "bag")
    for options, words in (
        ({"wrench": "/ft"}, "has no topic /ft; it has /ft/wrench (geometry_msgs/msg/WrenchStamped), "),
        ({"skin": "/ft/wrench"}, "/ft/wrench: its messages (geometry_msgs/msg/WrenchStamped) hold wrench; expected the skin"),
        ({"wrench": "/ft/wrench+/skin"}, "several topics can be the patches of a skin only"),
        ({"skin": "/skin?field=dota"}, "/skin: The field 'dota' of std_msgs/msg/Float32MultiArray does not exist"),
        (
            {"joints": "/joint_states", "names": ("j1", "elbow")},
            "/joint_states: No position of elbow came; the messages have j0",
        ),
    ):
        with pytest.raises(InputError) as refusal:
            open_bag(path, **options)
        assert words in str(refusal.value)


def test_empty_bags_and_topics_give_a_sentence(tmp_path):
    with BagFile(tmp_path / "empty", "mcap") as empty:
        empty.writer.add_connection("/ft/wrench", WRENCH_TYPE, typestore=empty.store)
        empty.writer.add_connection("/skin", SKIN_TYPE, typestore=empty.store)
    with pytest.raises(InputError, match="no topic has readings of a sensor or skin; it has /ft/wrench"):
        guess_streams([empty.path])
    with pytest.raises(InputError, match="/ft/wrench: /ft/wrench has no message; choose another topic"):
        open_bag(empty.path)
    with BagFile(tmp_path / "nothing", "ros1") as nothing:
        pass
    with pytest.raises(InputError, match="it has no topics"):
        guess_streams([nothing.path])
    (tmp_path / "folder.bag").mkdir()
    for path in (tmp_path / "gone.bag", tmp_path / "folder.bag"):
        with pytest.raises(InputError):
            open_bag(path)


@pytest.mark.parametrize("kind", ["mcap", "sqlite3", "ros1"])
def test_bags_that_are_cut_off_say_so(tmp_path, kind):
    path = write_small(tmp_path / "bag", kind)
    file = path if path.is_file() else next(each for each in path.iterdir() if each.name != "metadata.yaml")
    whole = file.read_bytes()
    expected = readings(open_bag(path))[0]["wrench"][1]
    refused = 0
    for share in (0.0, 0.001, 0.5, 0.9, 0.999):
        file.write_bytes(whole[: int(share * len(whole))])
        opened = None
        with contextlib.suppress(InputError):
            opened = open_bag(path)
        if opened is None:
            refused += 1
            continue
        found = readings(opened)[0]["wrench"][1]
        assert np.array_equal(found, expected[: len(found)])
        assert len(found) == len(expected) or any("damaged" in each or "announces" in each for each in opened.findings)


@pytest.mark.parametrize("has_metadata", [False, True])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.6])
@pytest.mark.parametrize("kind", ["mcap", "sqlite3"])
def test_damage_in_one_file_of_a_folder_leaves_the_others(tmp_path, kind, share, has_metadata):
    path = write_small(tmp_path / "bag", kind)
    with Bag(path) as bag:
        expected = list(bag.messages(["/ft/wrench"]))
    metadata = path / "metadata.yaml"
    file = next(each for each in path.iterdir() if each != metadata)
    if has_metadata:
        text = metadata.read_text()
        assert text.count(f"- {file.name}") == 1
        names = "".join(f"- {name}\n  " for name in (f"a_damaged{file.suffix}", "gone.mcap", file.name))
        metadata.write_text(text.replace(f"- {file.name}\n", names.rstrip(" ")))
    else:
        metadata.unlink()
    whole = file.read_bytes()
    at = int(share * len(whole))
    file.with_stem("a_damaged").write_bytes(whole[:at] + b"\xff" * 4000 + whole[at + 4000 :])
    with Bag(path) as bag:
        found = list(bag.messages(["/ft/wrench"]))
        assert Counter(found) >= Counter(expected)
        assert "a_damaged" in bag.damage + "".join(bag.findings)
        assert has_metadata == any("gone.mcap, which" in each for each in bag.findings)


@pytest.mark.parametrize("kind", ["mcap-zstd", "sqlite3", "ros1-lz4"])
def test_damaged_bytes_give_readings_or_a_sentence(tmp_path, rng, kind):
    path = write_small(tmp_path / "bag", kind, seconds=1.0)
    files = [path] if path.is_file() else sorted(path.iterdir())
    outcomes = set()
    for file in files:
        whole = file.read_bytes()
        for at in rng.integers(0, len(whole), 12).tolist():
            length = int(rng.integers(1, 9))
            file.write_bytes(whole[:at] + rng.bytes(length) + whole[at + length :])
            try:
                guess_streams([path])
                readings(open_bag(path))
                outcomes.add("readings")
            except InputError:
                outcomes.add("sentence")
        file.write_bytes(whole)
    assert outcomes == {"readings", "sentence"}


def test_the_command_is_stopped_and_leaves_nothing(tmp_path):
    path = write_small(tmp_path / "bag", seconds=60.0)
    scene = load_scene(resource("scenes/flat-patch/scene.toml"))
    files = RecordingFiles(RecordedPlace(path, "/ft/wrench"), RecordedPlace(path, "/skin"))
    for limit in (0.0, 0.2, 0.6):
        shares = []

        def go_on(share, limit=limit, shares=shares):
            shares.append(share)
            return share < limit

        with pytest.raises(StoppedError):
            import_recording(ImportRequest(files, scene.path, "", tmp_path / "deep" / "session"), go_on)
        assert not (tmp_path / "deep").exists()
        assert shares == sorted(shares)
        assert shares[-1] >= limit


def test_the_command_proposes_topics_and_says_which(tmp_path, capsys):
    path = write_small(tmp_path / "bag", seconds=8.0)
    arguments = ["import", "rosbag", str(path), "--scene", "flat-patch", "--json", "--out"]
    code = main([*arguments, str(tmp_path / "a")])
    out = capsys.readouterr()
    assert (code, "skin readings of 24 values arrive" in out.err or "24" in out.err) == (2, True)
    assert main([*arguments, str(tmp_path / "b"), "--skin", "/nowhere"]) == 2
    assert "has no topic /nowhere" in capsys.readouterr().err
    assert list(tmp_path.glob("[ab]")) == []


def test_a_preview_shows_the_streams_and_misfits(tmp_path):
    path = write_small(tmp_path / "bag")
    preview = preview_recording(guess_streams([path]))
    assert [(each.rows, each.width) for each in preview.streams] == [(400, 6), (200, 24), (80, 5)]
    assert preview.importer.name == "rosbag"
    assert preview.streams[1].path == f"{path}::/skin"


# ------------------------------------------------------------------ records and tapes


def test_records_are_read_however_they_are_cut_and_damaged(rng):
    values = rng.normal(size=(40, 3))
    data = b"".join(pack_records(np.arange(40), np.arange(40) * 0.01, values))
    for size in (1, 7, 100, len(data)):
        decoder = RecordsDecoder(3, (Stream.SKIN,))
        batches = [batch for at in range(0, len(data), size) for batch in decoder.feed(data[at : at + size])]
        assert np.array_equal(np.concatenate([batch.values for batch in batches]), values)
        assert not decoder.counts
    many = RecordsDecoder(3, (Stream.SKIN,)).feed_many([data[: len(data) // 2], data[len(data) // 2 :]])
    assert many is not None
    assert (many[1], np.array_equal(many[0].values, values)) == ([20, 40], True)
    assert RecordsDecoder(3, (Stream.SKIN,)).feed_many([data[:50], data[50:]]) is None
    narrow = b"".join(pack_records(np.arange(2), np.arange(2.0), np.ones((2, 1))))
    decoder = RecordsDecoder(3, (Stream.SKIN,))
    assert [len(batch.values) for batch in decoder.feed(data + narrow)] == [40]
    assert decoder.counts[Loss.BAD_WIDTH] == 2
    assert [len(batch.values) for batch in decoder.feed(data)] == [40], "a whole chunk is read at once again"
    for at in range(200):
        broken = RecordsDecoder(3, (Stream.SKIN,))
        twisted = bytearray(data)
        twisted[at] ^= 0xFF
        count = sum(len(batch.values) for batch in broken.feed(bytes(twisted)))
        assert count >= 39 or broken.counts.total() or broken._packets.has_partial_frame


def test_tapes_keep_rows_of_all_widths_and_precisions(rng):
    tape, rows = Tape(), [rng.normal(size=width) for width in [3] * 5000 + [0, 2, 2, 3]]
    rows += [np.arange(4.0)] * 10
    times = NumberFile()
    for at, row in enumerate(rows):
        tape.add(row)
        times.append(float(at))
    for _ in range(2):
        decoder = RecordsDecoder(None, (Stream.JOINTS,))
        del decoder._widths[Stream.JOINTS]
        lines = [line for block in tape.lines(times) for line in block]
        assert len(lines) == len(rows)
        found = [np.frombuffer(line[21:], "<f8" if line[0] == 1 else "<f4") for line in lines]
        assert all(np.array_equal(one, other) for one, other in zip(found, rows, strict=True))
    assert len(lines[-1]) == 21 + 16, "numbers of single precision take four bytes"


# ------------------------------------------------------------------ a bag of another maker

DEBIAN_PYTHON = "/usr/bin/python3"
DEBIAN_WRITER = """
import sys, rosbag, rospy
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Float32MultiArray
with rosbag.Bag(sys.argv[1], "w", compression=sys.argv[2]) as bag:
    for k in range(400):
        stamp = rospy.Time(1700000000, k * 2500000 % 1000000000)
        wrench = WrenchStamped()
        wrench.header.stamp, wrench.header.seq, wrench.header.frame_id = stamp, k, "ft"
        wrench.wrench.force.x, wrench.wrench.torque.z = k, -0.5 * k
        bag.write("/ft/wrench", wrench, stamp)
        bag.write("/skin", Float32MultiArray(data=[k, 0.25]), stamp)
        bag.write("/joint_states", JointState(header=wrench.header, name=["b", "a"], position=[0.1, 0.2]), stamp)
"""


@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
def test_a_bag_of_ros_1_itself_is_read(tmp_path, compression):
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    check = "import rosbag, geometry_msgs, sensor_msgs"
    if (
        not Path(DEBIAN_PYTHON).exists()
        or subprocess.run([DEBIAN_PYTHON, "-c", check], env=environment, capture_output=True).returncode
    ):
        pytest.skip("needs ROS 1's own writer: apt-get install python3-rosbag python3-sensor-msgs python3-geometry-msgs")
    path = tmp_path / "real.bag"
    subprocess.run(
        [DEBIAN_PYTHON, "-c", DEBIAN_WRITER, str(path), compression], env=environment, check=True, capture_output=True
    )
    values, losses = readings(open_bag(path, joints="/joint_states", names=("a", "b")))
    assert losses == {}
    assert values["wrench"][1][5].tolist() == [5, 0, 0, 0, 0, -2.5]
    np.testing.assert_allclose(values["wrench"][0], 1.7e9 + np.arange(400) * 0.0025, atol=5e-7)
    assert values["skin"][1][7].tolist() == [7, 0.25]
    np.testing.assert_allclose(values["joints"][1], [[0.2, 0.1]] * 400)
    assert guess_streams([path]).skin == RecordedPlace(path, "/skin")

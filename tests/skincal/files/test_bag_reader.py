"""Bags that other programs wrote, compressed or did not finish have the messages of a plain bag, or a sentence on the cause."""

import contextlib
import shutil
import sqlite3
import struct
from collections import Counter

import pytest
import zstandard
from mcap.writer import CompressionType, IndexType, Writer

from skincal.files.importers.bag_reader import Bag
from skincal.files.importers.preview import guess_streams
from skincal.files.importers.registry import RecordedPlace, find_recordings, is_recording
from skincal.model.errors import InputError
from skincal.ros.types import MessageError, MessageTypes
from tests.skincal.files.test_rosbag import open_bag, readings, write_small
from tests.skincal.ros_support import WRENCH_TYPE, make_message, wrench_message

WRENCH_IDL = """{head}
IDL: geometry_msgs/msg/WrenchStamped
// generated from rosidl_adapter/resource/msg.idl.em
#include "std_msgs/msg/Header.idl"
module geometry_msgs {{ module msg {{ @verbatim (language="comment", text="A wrench") struct WrenchStamped {{
  std_msgs::msg::Header header; geometry_msgs::msg::Wrench wrench; }}; }}; }};
{head}
IDL: geometry_msgs/msg/Wrench
module geometry_msgs {{ module msg {{ struct Wrench {{
  geometry_msgs::msg::Vector3 force; geometry_msgs::msg::Vector3 torque; }}; }}; }};
{head}
IDL: geometry_msgs/msg/Vector3
module geometry_msgs {{ module msg {{ struct Vector3 {{ double x; double y; double z; }}; }}; }};
""".format(head="=" * 80)
LAB_TYPE = "lab_msgs/msg/Taxels"
LAB_IDL = """#include <std_msgs/msg/Header.idl>
module lab_msgs { module msg { typedef unsigned short raw__3[3];
  struct Taxels { std_msgs::msg::Header header; lab_msgs::msg::raw__3 raw; sequence<float> values; }; }; };"""
DDS_IDL = """module lab_msgs { module msg { module dds_ {
  struct Part_ { unsigned short raw; }; struct Taxels_ { sequence<lab_msgs::msg::dds_::Part_> parts; }; }; }; };"""


def plain_messages(path):
    """Topic, type, arrival and bytes of the messages of a bag."""
    with Bag(path) as bag:
        found = list(bag.messages(["/ft/wrench", "/skin"]))
        return [(topic, bag.topics[topic].type_name, arrival_ns, data) for topic, arrival_ns, data in found]


def write_mcap(path, messages, profile="", encodings=("cdr", "ros2msg", None), others=(), library="lab", **options):
    """Write an MCAP file with the definitions of one language, and channels of other encodings."""
    encoding, language, definitions = encodings
    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start(profile, library)
        for topic, other in others:
            schema = writer.register_schema("Note", "jsonschema" if other == "json" else other, b"{}")
            channel = writer.register_channel(topic, other, schema)
            writer.add_message(channel, messages[0][2], b"{}", messages[0][2])
        channels = {}
        for topic, type_name, arrival_ns, data in messages:
            if topic not in channels:
                text = (definitions or {}).get(type_name, "")
                name = type_name.replace("/msg/", "/") if encoding == "ros1" else type_name
                channels[topic] = writer.register_channel(
                    topic, encoding, writer.register_schema(name, language, text.encode())
                )
            writer.add_message(channels[topic], arrival_ns, data, arrival_ns)
        writer.finish()
    return path


@pytest.mark.parametrize("profile", ["", "ros2", "fastdds"])
def test_channels_of_ros_are_read_whatever_the_profile_and_the_other_channels(tmp_path, profile):
    bag = write_small(tmp_path / "bag")
    others = [("/notes", "json"), ("/camera", "protobuf")]
    for name, options in (("plain", {}), ("no-index", {"index_types": IndexType.NONE}), ("flat", {"use_chunking": False})):
        path = write_mcap(tmp_path / f"{name}.mcap", plain_messages(bag), profile, ("cdr", "ros2msg", None), others, **options)
        opened = open_bag(path)
        expected, found = readings(open_bag(bag))[0], readings(opened)[0]
        assert all((found[stream][1] == expected[stream][1]).all() for stream in ("wrench", "skin"))
        assert "left out, since the messages are not those of ROS: /notes (json), /camera (protobuf)." in "".join(
            opened.findings
        )
        assert guess_streams([path]).skin == RecordedPlace(path, "/skin")
        with pytest.raises(InputError, match=r"the messages of /notes are json; expected those of ROS \(cdr or ros1\)"):
            open_bag(path, skin="/notes")


def test_a_file_without_messages_of_ros_names_their_encodings(tmp_path):
    path = write_mcap(tmp_path / "a.mcap", [("/x", "x", 5, b"")], "", ("json", "jsonschema", None), [("/y", "protobuf")])
    with pytest.raises(InputError, match=r"no topic has readings of a sensor or skin; it has /y \(protobuf\), /x \(json\)"):
        guess_streams([path])


def test_messages_of_ros_1_in_a_file_of_mcap_are_read(tmp_path):
    bag = write_small(tmp_path / "bag", "ros1")
    expected = readings(open_bag(bag))[0]
    path = write_mcap(tmp_path / "converted.mcap", plain_messages(bag), "ros1", ("ros1", "ros1msg", None))
    found = readings(open_bag(path))[0]
    assert all((found[stream][1] == expected[stream][1]).all() for stream in ("wrench", "skin"))
    assert guess_streams([path]).wrench == RecordedPlace(path, "/ft/wrench")


def test_definitions_in_idl_are_read(tmp_path):
    types = MessageTypes()
    types.add_definition(LAB_TYPE, "std_msgs/Header header\nuint16[3] raw\nfloat32[] values\n")
    content = wrench_message(7, range(6))
    messages = []
    for k in range(50):
        wrench = types.encode(make_message(types, WRENCH_TYPE, wrench_message(k * 10**7 + 1, [k, 1, 2, 3, 4, 5])), WRENCH_TYPE)
        frame = {"header": content["header"], "raw": [k, 7, 40000], "values": [0.5, k]}
        skin = types.encode(make_message(types, LAB_TYPE, frame), LAB_TYPE)
        messages += [("/ft", WRENCH_TYPE, k * 10**7 + 1, wrench), ("/skin", LAB_TYPE, k * 10**7 + 1, skin)]
    definitions = {WRENCH_TYPE: WRENCH_IDL, LAB_TYPE: LAB_IDL}
    path = write_mcap(tmp_path / "idl.mcap", messages, "ros2", ("cdr", "ros2idl", definitions))
    values = readings(open_bag(path, "/ft", "/skin?field=raw"))[0]
    assert values["wrench"][1][9].tolist() == [9, 1, 2, 3, 4, 5]
    assert values["skin"][1][9].tolist() == [9, 7, 40000]
    assert readings(open_bag(path, "/ft", "/skin?field=values"))[0]["skin"][1][9].tolist() == [0.5, 9]
    # Where a definition cannot be parsed, that of ROS itself counts.
    for text in ("struct {", "module a { module msg { struct B { long c; }; }; };"):
        definitions = {WRENCH_TYPE: text, LAB_TYPE: LAB_IDL}
        broken = write_mcap(tmp_path / "broken.mcap", messages, "ros2", ("cdr", "omgidl", definitions))
        assert readings(open_bag(broken, "/ft", "/skin"))[0]["wrench"][1][9].tolist() == [9, 1, 2, 3, 4, 5]
    definitions = {LAB_TYPE: "struct {"}
    broken = write_mcap(tmp_path / "broken.mcap", messages, "ros2", ("cdr", "ros2idl", definitions))
    with pytest.raises(InputError, match="lab_msgs/msg/Taxels: its definition cannot be read; expected IDL"):
        open_bag(broken, "/ft", "/skin")


def test_names_of_dds_are_those_of_ros():
    types = MessageTypes()
    types.add_definition("lab_msgs/msg/dds_/Taxels_", DDS_IDL, "idl")
    part = types.make("lab_msgs/msg/Part", raw=40000)
    data = types.encode(types.make(LAB_TYPE, parts=[part, part]), LAB_TYPE)
    assert [each.raw for each in types.decode(data, LAB_TYPE).parts] == [40000, 40000]


# ------------------------------------------------------------------ compressed


@pytest.mark.parametrize("kind", ["sqlite3", "mcap"])
@pytest.mark.parametrize("suffix", [".zstd", ".zst"])
def test_compressed_files_are_read_without_metadata(tmp_path, kind, suffix):
    bag = write_small(tmp_path / "bag", kind)
    expected = plain_messages(bag)
    file = next(each for each in bag.iterdir() if each.name != "metadata.yaml")
    packed = file.with_name(file.name + suffix)
    # As a stream has it: without the size of its content.
    with file.open("rb") as source, packed.open("wb") as target:
        zstandard.ZstdCompressor().copy_stream(source, target)
    file.unlink()
    assert plain_messages(bag) == expected, "the metadata names the unpacked file"
    (bag / "metadata.yaml").unlink()
    assert find_recordings(bag) == [bag]
    assert is_recording(packed)
    for path in (bag, packed):
        assert plain_messages(path) == expected
        assert guess_streams([path]).wrench == RecordedPlace(path, "/ft/wrench")
    packed.write_bytes(packed.read_bytes()[:200])
    with pytest.raises(InputError, match="the bag cannot be opened"):
        Bag(packed)


def test_metadata_may_name_the_file_before_it_was_unpacked(tmp_path):
    bag = write_small(tmp_path / "bag", "sqlite3-file")
    expected = plain_messages(bag)
    (packed,) = bag.glob("*.zstd")
    with packed.open("rb") as source, packed.with_suffix("").open("wb") as target:
        zstandard.ZstdDecompressor().copy_stream(source, target)
    packed.unlink()
    assert plain_messages(bag) == expected


def test_single_messages_that_are_compressed_are_read_without_metadata(tmp_path):
    bag = write_small(tmp_path / "bag", "sqlite3-message")
    expected = plain_messages(bag)
    (bag / "metadata.yaml").unlink()
    assert plain_messages(bag) == expected
    assert plain_messages(next(bag.glob("*.db3"))) == expected
    values, losses = readings(open_bag(bag))
    assert (values["wrench"][1][7].tolist(), losses) == ([7, 7.5, -7, 0.1, 0.2, 0.3], {})


def test_a_database_whose_recorder_found_no_definition_is_read(tmp_path):
    bag = write_small(tmp_path / "bag", "sqlite3")
    expected, file = plain_messages(bag), next(bag.glob("*.db3"))
    with contextlib.closing(sqlite3.connect(file)) as database:
        database.execute("UPDATE message_definitions SET encoding = 'unknown', encoded_message_definition = ''")
        database.commit()
    whole = file.read_bytes()
    assert plain_messages(bag) == expected
    assert guess_streams([bag]).skin == RecordedPlace(bag, "/skin")
    assert file.read_bytes() == whole


# ------------------------------------------------------------------ unfinished


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4])
@pytest.mark.parametrize("share", [0.999, 0.6, 0.3])
def test_an_mcap_file_without_end_is_read_up_to_its_last_whole_part(tmp_path, compression, share):
    messages = plain_messages(write_small(tmp_path / "bag"))
    options = {"chunk_size": 8000, "compression": compression}
    path = write_mcap(tmp_path / "a.mcap", messages, "ros2", ("cdr", "ros2msg", None), **options)
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    found = plain_messages(path)
    assert Counter(found) <= Counter(messages)
    assert len(found) > (share - 0.25) * len(messages)
    opened = open_bag(path)
    assert "a.mcap is damaged, or its recorder was killed (it has no end)" in "".join(opened.findings)
    assert not any("mcap recover" in each for each in opened.findings)


def test_a_file_that_is_no_mcap_file_says_so(tmp_path):
    path = tmp_path / "a.mcap"
    for data, words in (
        (b"", "it is empty"),
        (b"#ROSBAG V2.0\n", "it does not begin as an MCAP file"),
        (b"\x89MCAP0\r\n\x01", "it is cut off before its first message"),
    ):
        path.write_bytes(data)
        with pytest.raises(InputError, match=words):
            Bag(path)


@pytest.mark.parametrize("kind", ["ros1", "ros1-bz2", "ros1-lz4"])
def test_a_bag_of_ros_1_that_was_not_finished_is_read(tmp_path, kind):
    whole = write_small(tmp_path / "bag", kind, seconds=20.0)
    expected, data = plain_messages(whole), bytearray(whole.read_bytes())
    # The recorder writes the place of the index and the number of its entries last: both are still 0.
    head = data.index(b"index_pos=") + len(b"index_pos=")
    (index_at,) = struct.unpack_from("<Q", data, head)
    data[head : head + 8] = bytes(8)
    active = tmp_path / "bag.bag.active"
    active.write_bytes(data[:index_at])
    assert plain_messages(active) == expected
    assert guess_streams([active]).wrench == RecordedPlace(active, "/ft/wrench")
    opened = open_bag(active)
    assert any("bag.bag.active is damaged, or its recorder was killed (it has no index)" in each for each in opened.findings)
    active.write_bytes(data[: int((0.5 if kind == "ros1" else 0.05) * index_at)])
    if kind == "ros1":
        assert 0.3 * len(expected) < len(plain_messages(active)) < 0.7 * len(expected)
        # The recorder was killed in its only chunk, whose length is then still 0.
        head = data.index(b"size=") + len(b"size=") + 4
        (length,) = struct.unpack_from("<I", data, head)
        assert 0.5 * len(data) < length < len(data)
        data[head : head + 4] = bytes(4)
        active.write_bytes(data[: head + length // 2])
        assert 0.3 * len(expected) < len(plain_messages(active)) < 0.7 * len(expected)
    else:
        with pytest.raises(InputError, match="the bag cannot be opened"):
            Bag(active)


def test_a_definition_must_have_its_type():
    types = MessageTypes()
    with pytest.raises(InputError, match="its definition in IDL has a/msg/B; expected a/msg/C"):
        types.add_definition("a/msg/C", "module a { module msg { struct B { long c; }; }; };", "idl")
    types.add_definition("a/msg/D", "module a { module msg { enum E { A, B }; struct D { E e; }; }; };", "idl")
    with pytest.raises(MessageError, match="a/msg/E has no definition here"):
        types.decode(b"\0\1\0\0\0\0\0\0", "a/msg/D")


def test_the_folder_of_an_unpacked_file_is_removed(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path / "unpacked"))
    (tmp_path / "unpacked").mkdir()
    monkeypatch.setattr("tempfile.tempdir", None)
    bag = write_small(tmp_path / "bag", "sqlite3-file")
    with Bag(bag):
        assert len(list((tmp_path / "unpacked").iterdir())) == 1
    assert list((tmp_path / "unpacked").iterdir()) == []
    shutil.rmtree(bag)

#!/usr/bin/env bash
# rosbags refuses a whole ROS 2 bag in MCAP because one channel has JSON messages: no topic can be read, not even those of ROS.
#
# MCAP lets channels of any encoding stand in one file; recorders that add notes or settings as JSON write such files. The
# library mcap reads all channels of the same file. Expected: the topics of ROS are read. Seen: opening fails with a KeyError of
# the schema's encoding, so nothing names the channel or says that the file is whole.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv venv && venv/bin/pip install -q --disable-pip-version-check rosbags==0.11.9 mcap==1.6.0
cat > try.py <<'P'
import struct
import sys
from importlib.metadata import version
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.highlevel import AnyReader

READINGS = 5


def write(path, with_notes):
    """A bag as a recorder of ROS 2 writes it: five readings, and with the notes one JSON message."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="finding")
        schema = writer.register_schema("std_msgs/msg/Float64", "ros2msg", b"float64 data\n")
        channel = writer.register_channel("/force", "cdr", schema)
        for k in range(READINGS):
            data = b"\x00\x01\x00\x00" + struct.pack("<d", float(k))
            writer.add_message(channel, k * 10**9, data, k * 10**9, k)
        if with_notes:
            schema = writer.register_schema("note", "jsonschema", b'{"type": "object"}')
            channel = writer.register_channel("/notes", "json", schema)
            writer.add_message(channel, 0, b'{"operator": "hand"}', 0, 0)
        writer.finish()


def count(path):
    """Messages of /force that rosbags reads, or the error that it ends with."""
    try:
        with AnyReader([path]) as reader:
            connections = [each for each in reader.connections if each.topic == "/force"]
            return len(list(reader.messages(connections)))
    except Exception as error:  # whatever it is, it is what is shown
        return repr(error)


found = {}
for name, with_notes in (("readings alone", False), ("with one JSON message", True)):
    path = Path(f"{with_notes}.mcap")
    write(path, with_notes)
    with path.open("rb") as file:
        theirs = sum(channel.topic == "/force" for _, channel, _ in make_reader(file).iter_messages())
    found[with_notes] = count(path)
    print(f"{name}: the library mcap reads {theirs} messages of /force; rosbags: {found[with_notes]}")
print("rosbags", version("rosbags"), "mcap", version("mcap"), "- expected by users: 5 both times; behaviour: the bag is refused")
sys.exit(0 if found[False] == READINGS and "jsonschema" in str(found[True]) else 1)
P
venv/bin/python try.py

#!/usr/bin/env bash
# rosbags 0.11.9 reads ROS 2's byte as signed: a tactile reading of 200 becomes -56.
#
# std_msgs/ByteMultiArray and "byte[]" fields carry raw samples of 8 bits. In ROS 2, byte is an octet: uint8_t in C++, bytes in
# Python, octet in DDS (ROS 2 documentation, "About interfaces", table of field types). Only in ROS 1 is it an alias of int8.
# Expected: 200. Seen: an array of int8, so all values above 127 are negative. The library mcap-ros2-support reads the octets of
# the same file. Nothing is printed.
# Remedy: array.view("uint8").
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv venv
venv/bin/pip install -q --disable-pip-version-check rosbags==0.11.9 mcap==1.6.0 mcap-ros2-support==0.6.0 numpy==2.4.6
cat > try.py <<'P'
import struct
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

SAMPLES = [3, 127, 128, 200, 255]
DEFINITION = b"byte largest\nbyte[] samples\n"
path = Path("skin.mcap")
with path.open("wb") as file:
    writer = Writer(file)
    writer.start(profile="ros2", library="finding")
    schema = writer.register_schema("skin_msgs/msg/Samples", "ros2msg", DEFINITION)
    channel = writer.register_channel("/skin", "cdr", schema)
    little_endian = b"\x00\x01\x00\x00"
    content = struct.pack("<B3xI", max(SAMPLES), len(SAMPLES)) + bytes(SAMPLES)
    writer.add_message(channel, 0, little_endian + content, 0, 0)
    writer.finish()

with path.open("rb") as file:
    ((_, _, _, theirs),) = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
with AnyReader([path]) as reader:
    ((connection, _, raw),) = reader.messages()
    found = reader.deserialize(raw, connection.msgtype)
print("rosbags", version("rosbags"), "mcap-ros2-support", version("mcap-ros2-support"))
print("samples in the message:", SAMPLES, "largest:", max(SAMPLES))
print("mcap-ros2-support:     ", list(theirs.samples), "largest:", theirs.largest)
print("rosbags:               ", found.samples.tolist(), "largest:", found.largest, found.samples.dtype)
wrapped = [value - 256 if value > 127 else value for value in SAMPLES]
right = list(theirs.samples) == SAMPLES and theirs.largest == max(SAMPLES)
seen = right and found.samples.tolist() == wrapped and found.largest == -1 and found.samples.dtype == np.int8
print("behaviour: values above 127 are negative" if seen else "the behaviour has changed")
sys.exit(0 if seen else 1)
P
venv/bin/python try.py

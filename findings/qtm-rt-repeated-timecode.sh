#!/usr/bin/env bash
# qtm-rt 3.1.0 (Qualisys' SDK for Python): get_timecode gives the first time code of a packet for each of them.
#
# A packet of QTM may have several time codes: SMPTE, IRIG and the time of the cameras, each with its type and two words of 32
# bits. Expected: three entries, one of each type, as the maker's protocol documentation describes the component. Seen: three
# entries, all of the first type with its numbers. So a user who asks for the time of the cameras reads that of SMPTE, without
# a word. Other components of a packet are read at their places.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv venv && venv/bin/pip install -q --disable-pip-version-check qtm-rt==3.1.0
cat > try.py <<'P'
import struct
import sys
from importlib.metadata import version

from qtm_rt.packet import QRTPacket

SMPTE, IRIG, CAMERA_TIME = 0, 1, 2
TIMECODES_KIND = 17
sent = [(SMPTE, 0, 0x00123456), (IRIG, 0x000002A1, 0x00000F0F), (CAMERA_TIME, 7, 123456789)]
content = struct.pack("<I", len(sent)) + b"".join(struct.pack("<iII", *code) for code in sent)
component = struct.pack("<II", 8 + len(content), TIMECODES_KIND) + content
packet = QRTPacket(struct.pack("<qII", 1_000_000, 1, 1) + component)
head, found = packet.get_timecode()
print("qtm-rt", version("qtm-rt"))
print("time codes in the packet:", sent)
print("time codes that it gives: ", [tuple(code) for code in found])
print("expected: the same three; behaviour: the first one", head.timecode_count, "times")
if [tuple(code) for code in found] != [sent[0]] * len(sent):
    print("the behaviour has changed")
    sys.exit(1)
P
venv/bin/python try.py

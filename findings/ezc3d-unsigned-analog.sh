#!/usr/bin/env bash
# ezc3d 1.7.2: analog samples of a C3D file with ANALOG:FORMAT "UNSIGNED" are read as signed; half of the range is off by 65536.
#
# Some recorders with converters of 16 bits store force plates and other sensors this way, with an ANALOG:OFFSET of half the
# range. The C3D user guide (c3d.org): with this word in ANALOG:FORMAT, samples and offsets are unsigned integers of 16 bits.
# Expected: counts 32760 to 32776 less the offset of 32768, thus -8 to 8 (the library c3d reads this). Seen: the offset is read
# as unsigned, the samples are not. So a load that passes zero jumps by 65536 counts. The word is returned in the parameters.
# Remedy: where the word is UNSIGNED, add 65536 counts (times the scale) to samples below minus the offset.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv venv && venv/bin/pip install -q --disable-pip-version-check ezc3d==1.7.2 c3d==0.6.0 numpy==2.4.6
cat > try.py <<'P'
import struct
import sys
from importlib.metadata import version

import c3d
import ezc3d
import numpy as np

COUNTS = [32760, 32764, 32768, 32772, 32776]
OFFSET, RATE, BLOCK = 32768, 100.0, 512
TEXT, INTEGER, REAL = -1, 2, 4


def group(number, name):
    return struct.pack("<bb", len(name), -number) + name + struct.pack("<hB", 3, 0)


def parameter(number, name, kind, dimensions, value):
    body = struct.pack("<bB", kind, len(dimensions)) + bytes(dimensions) + value + b"\0"
    return struct.pack("<bb", len(name), number) + name + struct.pack("<h", 2 + len(body)) + body


def whole(number, name, value):
    return parameter(number, name, INTEGER, [], struct.pack("<H", value))


def real(number, name, value):
    return parameter(number, name, REAL, [], struct.pack("<f", value))


def text(number, name, value):
    return parameter(number, name, TEXT, [len(value)], value)


def texts(number, name, value):
    return parameter(number, name, TEXT, [len(value), 1], value)


n = len(COUNTS)
point, analog = 1, 2
parameters = (
    group(point, b"POINT") + whole(point, b"USED", 0) + whole(point, b"FRAMES", n) + real(point, b"SCALE", 0.1)
    + real(point, b"RATE", RATE) + whole(point, b"DATA_START", 3) + text(point, b"UNITS", b"mm")
    + group(analog, b"ANALOG") + whole(analog, b"USED", 1) + real(analog, b"RATE", RATE) + real(analog, b"GEN_SCALE", 1.0)
    + parameter(analog, b"SCALE", REAL, [1], struct.pack("<f", 1.0))
    + parameter(analog, b"OFFSET", INTEGER, [1], struct.pack("<H", OFFSET))
    + text(analog, b"FORMAT", b"UNSIGNED") + whole(analog, b"BITS", 16)
    + texts(analog, b"LABELS", b"load") + texts(analog, b"UNITS", b"N") + texts(analog, b"DESCRIPTIONS", b"load")
)
intel = 84
head = struct.pack("<BBHHHHHfHHf", 2, 0x50, 0, 1, 1, n, 0, 0.1, 3, 1, RATE)
with open("load.c3d", "wb") as file:
    file.write(head.ljust(BLOCK, b"\0"))
    file.write((struct.pack("<BBBB", 1, 0x50, 1, intel) + parameters + b"\0\0").ljust(BLOCK, b"\0"))
    file.write(struct.pack(f"<{n}H", *COUNTS).ljust(BLOCK, b"\0"))

truth = [count - OFFSET for count in COUNTS]
theirs = ezc3d.c3d("load.c3d")
found = theirs["data"]["analogs"][0, 0]
with open("load.c3d", "rb") as file:
    others = np.concatenate([samples[0] for _, _, samples in c3d.Reader(file).read_frames()])
print("ezc3d", version("ezc3d"), "format:", theirs["parameters"]["ANALOG"]["FORMAT"]["value"])
print("expected:  ", truth)
print("c3d 0.6.0: ", others.tolist())
print("ezc3d:     ", found.tolist())
wrapped = [value - 65536 if count >= OFFSET else value for value, count in zip(truth, COUNTS, strict=True)]
seen = others.tolist() == truth and found.tolist() == wrapped
print("behaviour: half of the range is off by 65536" if seen else "the behaviour has changed")
sys.exit(0 if seen else 1)
P
venv/bin/python try.py

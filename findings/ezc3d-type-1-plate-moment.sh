#!/usr/bin/env bash
# ezc3d 1.7.2: the moment of a force plate of type 1 has the wrong sign, so it contradicts the force and the centre of pressure.
#
# A C3D file says how its force plates store a load. Type 1 stores the force, its place on the plate and the free moment; type 2
# stores the force and the moment. With extract_forceplat_data=True, ezc3d gives force, moment about the plate's centre, centre of
# pressure and free moment of either type; kineticstoolkit passes them on. Expected: one load gives one moment,
# (place - centre) x force + free moment. That is how mechanics defines it. Seen: type 2 is right. Type 1 has every component of
# the moment negated, the free moment's part too, with a right force, place and free moment next to it. Nothing is printed.
# Remedy: compute the moment from "center_of_pressure", "force" and "Tz".
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv venv && venv/bin/pip install -q --disable-pip-version-check ezc3d==1.7.2 numpy==2.4.6
cat > try.py <<'P'
import struct
import sys

import ezc3d
import numpy as np

# The plate's axes are the axes of the room, and its centre is the origin: no turn and no shift can hide a sign. N and mm.
PLACE, FORCE, FREE_MOMENT = np.array([100.0, -50.0, 0.0]), np.array([20.0, -30.0, 400.0]), np.array([0.0, 0.0, 5000.0])
MOMENT = np.cross(PLACE, FORCE) + FREE_MOMENT
CORNERS = [300, 200, 0, -300, 200, 0, -300, -200, 0, 300, -200, 0]
STORED = {1: [*FORCE, *PLACE[:2], FREE_MOMENT[2]], 2: [*FORCE, *MOMENT]}
UNITS = {1: ["N", "N", "N", "mm", "mm", "Nmm"], 2: ["N", "N", "N", "Nmm", "Nmm", "Nmm"]}
FRAMES, RATE, BLOCK = 3, 100.0, 512


def group(number, name, parameters):
    """Bytes of a group; a value is text, texts, a whole number (or some, with dimensions) or real numbers with dimensions."""
    body = struct.pack("<bb", len(name), -number) + name.encode() + struct.pack("<hB", 3, 0)
    for key, value in parameters.items():
        if isinstance(value, str):
            kind, dimensions, content = -1, [len(value)], value.encode()
        elif isinstance(value, int):
            kind, dimensions, content = 2, [], struct.pack("<h", value)
        elif isinstance(value[0], str):
            width = max(map(len, value))
            kind, dimensions, content = -1, [width, len(value)], "".join(each.ljust(width) for each in value).encode()
        elif isinstance(value[0], int):
            kind, dimensions, content = 2, value[1], struct.pack(f"<{len(value[2])}h", *value[2])
        else:
            kind, dimensions, content = 4, value[1], struct.pack(f"<{len(value[2])}f", *value[2])
        content = struct.pack("<bB", kind, len(dimensions)) + bytes(dimensions) + content + b"\0"
        body += struct.pack("<bb", len(key), number) + key.encode() + struct.pack("<h", 2 + len(content)) + content
    return body


def read(kind):
    whole, real = 2, 4.0  # the first entry of a tuple says what its numbers are
    channels = [f"channel{k}" for k in range(6)]
    parameters = group(1, "POINT", {
        "USED": 1, "FRAMES": FRAMES, "DATA_START": 4, "LABELS": ["marker"], "DESCRIPTIONS": ["marker"], "UNITS": "mm",
        "SCALE": (real, [], [-1.0]), "RATE": (real, [], [RATE])})
    parameters += group(2, "ANALOG", {
        "USED": 6, "LABELS": channels, "DESCRIPTIONS": channels, "UNITS": UNITS[kind], "GEN_SCALE": (real, [], [1.0]),
        "SCALE": (real, [6], [1.0] * 6), "OFFSET": (whole, [6], [0] * 6), "RATE": (real, [], [RATE])})
    parameters += group(3, "FORCE_PLATFORM", {
        "USED": 1, "TYPE": (whole, [1], [kind]), "ZERO": (whole, [2], [0, 0]), "CORNERS": (real, [3, 4, 1], CORNERS),
        "ORIGIN": (real, [3, 1], [0.0] * 3), "CHANNEL": (whole, [6, 1], [1, 2, 3, 4, 5, 6])})
    head = struct.pack("<BBHHHHHfHHf", 2, 0x50, 1, 6, 1, FRAMES, 0, -1.0, 4, 1, RATE)
    frame = struct.pack("<10f", 0, 0, 0, 0, *STORED[kind])
    with open(f"plate{kind}.c3d", "wb") as file:
        file.write(head.ljust(BLOCK, b"\0"))
        file.write((struct.pack("<BBBB", 1, 0x50, 2, 84) + parameters + b"\0\0").ljust(2 * BLOCK, b"\0"))
        file.write((frame * FRAMES).ljust(BLOCK, b"\0"))
    return ezc3d.c3d(f"plate{kind}.c3d", extract_forceplat_data=True)["data"]["platform"][0]


print("ezc3d", ezc3d.__version__, "- expected moment:", MOMENT, "N mm")
moments = {}
for kind in (1, 2):
    plate = read(kind)
    moments[kind] = plate["moment"][:, 0]
    print(f"type {kind}: moment {moments[kind]} N mm, force {plate['force'][:, 0]}, place {plate['center_of_pressure'][:, 0]}")
    for name, truth in (("force", FORCE), ("center_of_pressure", PLACE), ("Tz", FREE_MOMENT)):
        assert np.allclose(plate[name][:, 0], truth, atol=1e-2), name
seen = np.allclose(moments[1], -MOMENT, atol=1e-2) and np.allclose(moments[2], MOMENT, atol=1e-2)
print("behaviour: type 1 gives the negative moment" if seen else "the behaviour has changed")
sys.exit(0 if seen else 1)
P
venv/bin/python try.py

#!/usr/bin/env bash
# pyxdf 1.17.5: after a dropout of four seconds in a skin at 100 Hz, readings have times that are seconds wrong, without a message.
#
# Lab Streaming Layer's recorder writes XDF files, each reading with its time. load_xdf smooths times of regular streams by
# default: it fits a line through each part between breaks. A break is longer than one second and than 500 samples (its options
# jitter_break_threshold_seconds and ..._samples; the larger one counts): at 100 Hz longer than 5 s. Expected: a time near
# the stored one. Seen: a board that pauses for 4 s moves times on both sides by up to 2.0 s, and the gap is not in the
# result. In a force stream at 1,000 Hz with the same gap the break is found, so force and skin no longer fit together.
# Remedy: dejitter_timestamps=False, or jitter_break_threshold_samples=1.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv venv && venv/bin/pip install -q --disable-pip-version-check pyxdf==1.17.5 numpy==2.4.6
cat > try.py <<'P'
import struct
import sys
from pathlib import Path

import numpy as np
import pyxdf

PART_S, GAP_S = 60.0, 4.0
RATES = {1: ("skin", 100.0), 2: ("force", 1000.0)}
HEADER = """<?xml version="1.0"?><info><name>{name}</name><type>{name}</type><channel_count>1</channel_count>
<nominal_srate>{rate}</nominal_srate><channel_format>float32</channel_format><created_at>0</created_at></info>"""


def chunk(tag, content):
    return b"\x04" + struct.pack("<IH", len(content) + 2, tag) + content


def times(rate):
    """A minute before a gap, and a minute after it."""
    before = np.arange(round(PART_S * rate)) / rate
    return 100.0 + np.concatenate([before, before + PART_S + GAP_S])


parts = [b"XDF:", chunk(1, b'<?xml version="1.0"?><info><version>1.0</version></info>')]
for number, (name, rate) in RATES.items():
    parts.append(chunk(2, struct.pack("<I", number) + HEADER.format(name=name, rate=rate).encode()))
for number, (_name, rate) in RATES.items():
    stored = times(rate)
    samples = b"".join(b"\x08" + struct.pack("<df", time, place) for place, time in enumerate(stored))
    parts.append(chunk(3, struct.pack("<I", number) + b"\x04" + struct.pack("<I", len(stored)) + samples))
    parts += [chunk(4, struct.pack("<Idd", number, time, 0.0)) for time in np.arange(stored[0], stored[-1], 5.0)]
    parts.append(chunk(6, struct.pack("<I", number) + b"<info><sample_count>0</sample_count></info>"))
Path("poke.xdf").write_bytes(b"".join(parts))

print("pyxdf", pyxdf.__version__)
worst = {}
for options in ({}, {"dejitter_timestamps": False}, {"jitter_break_threshold_samples": 1}):
    streams, _ = pyxdf.load_xdf("poke.xdf", **options)
    for stream in streams:
        name = stream["info"]["name"][0]
        stored = times(float(stream["info"]["nominal_srate"][0]))
        error = np.abs(stream["time_stamps"] - stored).max()
        worst[name, *options] = error
        largest = np.diff(stream["time_stamps"]).max()
        print(f"{name} {options}: times wrong by up to {error:.3f} s, longest gap in the result {largest:.3f} s instead of {GAP_S} s")
seen = worst["skin",] > 1.9 and worst["force",] < 0.01 and max(value for key, value in worst.items() if len(key) > 1) < 0.01
print("behaviour: the gap is smoothed away at 100 Hz" if seen else "the behaviour has changed")
sys.exit(0 if seen else 1)
P
venv/bin/python try.py

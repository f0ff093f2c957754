#!/usr/bin/env bash
# anyskin 1.0.0 and reskin_sensor 2.0.2: a reading's time is when it is taken from the queue, up to half a second after it came.
#
# AnySkin and ReSkin are magnetic skins on a serial port. get_data gives each reading with a time. Expected: the time at which the
# reading came, or at least readings as far apart as they came. Here five magnetometers send a frame each 10 ms, and the program
# does something else for 0.4 s before it asks. Seen: 30 readings with times within some milliseconds, of which the first is 0.4 s
# too late. After 0.6 s (above 4000 bytes wait) all waiting readings are thrown away, and nothing says so.
# Whoever pairs these readings with a force by time pairs a touch with the force of another moment.
# Remedy: ask from a thread that does nothing else, or AnySkinProcess with its buffer.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv venv
venv/bin/pip install -q --disable-pip-version-check anyskin==1.0.0 reskin_sensor==2.0.2 pyserial==3.5 numpy==2.4.6
cat > try.py <<'P'
import contextlib
import importlib
import io
import os
import pty
import struct
import sys
import threading
import time
import tty

MAGNETOMETERS, PERIOD_S, ASKED = 5, 0.01, 30


def board(port, sent, stop):
    """Send frames: each magnetometer's temperature, x, y, z; x of the first one counts the frames."""
    due = time.monotonic()
    while not stop.is_set():
        values = [20.0, float(len(sent)), 2.0, 3.0] + [20.0, 1.0, 2.0, 3.0] * (MAGNETOMETERS - 1)
        sent.append(time.time())
        os.write(port, struct.pack("<20f", *values) + b"\r\n")
        due += PERIOD_S
        time.sleep(max(0.0, due - time.monotonic()))


def measure(kind, pause_s):
    """Return how late the first reading's time is, the time between first and last, and the frames that never came."""
    host, device = pty.openpty()
    tty.setraw(device)
    tty.setraw(host)
    sent, stop = [], threading.Event()
    sender = threading.Thread(target=board, args=(host, sent, stop), daemon=True)
    sender.start()
    with contextlib.redirect_stdout(io.StringIO()):
        sensor = kind(num_mags=MAGNETOMETERS, port=os.ttyname(device), temp_filtered=True)
        before = read(sensor, 1)[0]
        time.sleep(pause_s)
        found = read(sensor, ASKED)
    stop.set()
    sender.join()
    (first_time, first), (last_time, last) = found[0], found[-1]
    return first_time - sent[first], last_time - first_time, first - before[1] - 1


def read(sensor, count):
    """Return time and number of each frame."""
    found = sensor.get_data(num_samples=count)
    if hasattr(found[0], "acq_delay"):
        return [(each.time, round(float(each.data[0]))) for each in found]
    return [(float(each[0]), round(float(each[1]))) for each in found]


seen = True
for name, kind in (("anyskin", "AnySkinBase"), ("reskin_sensor", "ReSkinBase")):
    sensor = getattr(importlib.import_module(name), kind)
    late, span, lost = measure(sensor, 0.4)
    print(f"{name}, after 0.4 s: first of {ASKED} is {late:.2f} s late, all within {span:.3f} s instead of 0.29 s; lost {lost}")
    seen = seen and late > 0.3 and span < 0.1 and lost == 0
    late, span, lost = measure(sensor, 0.6)
    print(f"{name}, after 0.6 s: {lost} frames lost, no message")
    seen = seen and lost > 40
print("behaviour: times of the queue, and frames dropped" if seen else "the behaviour has changed")
sys.exit(0 if seen else 1)
P
timeout 60 venv/bin/python try.py

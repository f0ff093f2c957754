#!/usr/bin/env bash
# NetFT 2.0.1 (ATI's Net F/T sensors): readings that the sensor marks as invalid come as good ones, and after a stream old ones come.
#
# A record of ATI's RDT protocol has three numbers before the forces: two counters and the status. 0xC0000000 is "F/T out of
# range" (ATI's manual of the Ethernet Axia, "Status Code"): the load is beyond what the sensor can measure. Expected: an error,
# or the status. Seen: the forces alone. Status and counters are dropped, so neither a fault nor a lost record can be noticed.
# After stopStreaming, getForce asks for one record. Expected: that record. Seen: the oldest one that waits from the stream.
# Remedy: read the socket (sensor.sock) and the status oneself; make a new Sensor after each stream.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv venv && venv/bin/pip install -q --disable-pip-version-check NetFT==2.0.1
cat > try.py <<'P'
import socket
import struct
import sys
import threading
import time

import NetFT

ADDRESS, PORT = "127.0.0.1", 49152
OUT_OF_RANGE = 0xC0000000
START = 2


class Box(threading.Thread):
    """A box on the loopback interface; the force in x counts its records."""

    def __init__(self):
        super().__init__(daemon=True)
        self.sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.sock.bind((ADDRESS, PORT))
        self.status, self.records = 0, 0

    def run(self):
        while True:
            data, sender = self.sock.recvfrom(64)
            _, command, count = struct.unpack("!HHI", data)
            if command == START:
                # A stream without end has 50 records here.
                for _ in range(count or 50):
                    self.records += 1
                    head = self.records, self.records, self.status
                    self.sock.sendto(struct.pack("!III6i", *head, self.records, 0, 0, 0, 0, 0), sender)


box = Box()
box.start()
sensor = NetFT.Sensor(ADDRESS)
box.status = OUT_OF_RANGE
force = sensor.getForce()
print("NetFT 2.0.1")
print(f"status 0x{OUT_OF_RANGE:08x}: getForce() gives {force}, no error")
seen = force == [1, 0, 0]
box.status = 0
sensor.startStreaming(handler=False)
time.sleep(0.5)
taken = [sensor.receive()[0] for _ in range(5)]
sensor.stopStreaming()
time.sleep(0.2)
force = sensor.getForce()
time.sleep(0.2)
print(f"five records of a stream: {taken}; after it, getForce() gives record {force[0]}; the box sent {box.records} for it")
seen = seen and taken == [2, 3, 4, 5, 6] and force[0] == 7 and box.records == 52
print("behaviour: the status is dropped, and an old record comes" if seen else "the behaviour has changed")
sys.exit(0 if seen else 1)
P
timeout 60 venv/bin/python try.py

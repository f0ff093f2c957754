"""Simulated devices of all kinds on one rig, each over its own transport to the real reader, as fast as bytes travel."""

import os
import queue
import threading
import time
from collections import Counter
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from skincal.model.readings import Chunk, LinkState, Stream
from skincal.simulation.board_formats import make_encoder
from skincal.simulation.boards import BoardHeader
from skincal.simulation.device import Clock, LossyLink, SimulatedDevice
from skincal.simulation.emulated_devices import MAKERS
from skincal.simulation.emulated_transports import MakerOutlets, RdtOutlet, TalkOutlet
from skincal.simulation.outlets import TcpOutlet
from skincal.simulation.rig_errors import RigErrors
from skincal.streams.links import LinkSpec, Reader

PTYS = hasattr(os, "openpty")
PATIENCE_S = 10.0
WRENCHES = ("netft", "bota", "robotiq", "robotiq-text", "rtde", "yarp", "skb", "lines", "leptrino", "justfloat")
SKINS = ("xela", "papillarray", "yarp", "skb", "lines", "justfloat", "anyskin", "inspire")
NARROW_SKINS = ("flexitac", "paxini", "paxini-module")
"""Skins whose values do not reach the 12 bits of the flat patch."""
FINGERS = ("tsf85", "paxini-module")
"""Skins that have too few taxels for the shipped scenes of their range."""
OWN = {"skb": "skb", "lines": "text"}
"""Boards of one's own, and the format that they speak."""


def pairs_of_each():
    """Each kind of wrench and of skin at least once; `tests/long` tries all pairs."""
    most = max(len(WRENCHES), len(SKINS))
    return [(WRENCHES[at % len(WRENCHES)], SKINS[at % len(SKINS)]) for at in range(most)]


@contextmanager
def reading(links, items=None):
    items = queue.SimpleQueue() if items is None else items
    readers = [Reader(link, items) for link in links]
    for reader in readers:
        reader.start()
    try:
        yield items
    finally:
        for reader in readers:
            reader.stop()


class Orchestra:
    """One rig whose wrench and skin every kind of device sends at once, each over its own transport."""

    def __init__(self, line, wrenches, skins):
        self.line = line
        self.outlets = {}
        makers = MakerOutlets(line.rig.scene.skin.channels)
        errors, rng = RigErrors.none(), np.random.default_rng(2)
        boards, skin = [], line.rig.scene.skin
        for stream, names, width in ((Stream.WRENCH, wrenches, 0), (Stream.SKIN, skins, skin.channels)):
            for name in names:
                link = f"{stream.value} {name}"
                way = LossyLink(0.001, errors, rng)
                hz = 500.0 if stream is Stream.WRENCH else 50.0
                if name in OWN:
                    encoder = make_encoder(OWN[name], line.rig.range[1], width)
                    self.outlets[link] = TcpOutlet()
                else:
                    maker = MAKERS[name]
                    hz, encoder = maker.hz or hz, maker.encoder()
                    if stream is Stream.SKIN:
                        encoder.skin_factor = maker.skin_factor(line.rig.scene, line.rig.range[1])
                    self.outlets[link] = makers.open(name, stream, tcp=not PTYS)
                if name == "lines":
                    self.outlets[link].address = self.outlets[link].address.replace("socket:", "lines:")
                header = BoardHeader("fw=1", width or 6)
                boards.append(SimulatedDevice(link, stream, hz, Clock(errors, rng), encoder, way, header))
        self.line._boards = boards
        self.links = {name: LinkSpec(name, outlet.address, (self.line.links[name],)) for name, outlet in self.outlets.items()}

    def play(self, brought):
        """Play to the end, and a little longer."""
        while not self.line.finished:
            self.step(brought)
        for _ in range(30):
            self.step(brought)

    def step(self, brought):
        """Play a block, and wait until its bytes are there."""
        self._talk(brought)
        for at_ns, link, data in self.line.advance():
            brought.now_ns, wanted = at_ns, brought.sizes[link] + len(data)
            self.outlets[link].write(data)
            end = time.monotonic() + PATIENCE_S
            while brought.sizes[link] < wanted:
                assert time.monotonic() < end, f"{link}: bytes were lost"
                brought.wait(0.1)
                self.outlets[link].poll()

    def _talk(self, brought):
        """Let the devices answer until all are asked for readings."""
        end = time.monotonic() + PATIENCE_S
        while True:
            for outlet in self.outlets.values():
                outlet.poll()
            if brought.opened >= self.links.keys() and all(map(is_asked, self.outlets.values())):
                return
            assert time.monotonic() < end, (
                f"{brought.opened} are open; {[each for each in brought.items if hasattr(each, 'state')]}"
            )
            brought.wait(0.01)

    def close(self):
        for outlet in self.outlets.values():
            outlet.close()


def is_asked(outlet):
    """Return whether a host gets what the device sends."""
    if type(outlet) is TcpOutlet:
        return bool(outlet._clients)
    if isinstance(outlet, TalkOutlet):
        return any(talk.ready for talk in outlet._talks.values())
    return outlet._host is not None if isinstance(outlet, RdtOutlet) else getattr(outlet, "_streams", True)


class Brought:
    """What readers bring, stamped by the rig's clock. It stands while bytes travel: a busy machine changes nothing."""

    def __init__(self):
        self.items, self.opened, self.sizes, self.now_ns = [], set(), Counter(), 0
        self._came = threading.Event()

    def put(self, item):
        self.items.append(replace(item, host_ns=self.now_ns))
        if isinstance(item, Chunk):
            self.sizes[item.link] += len(item.data)
        elif item.state is LinkState.OPEN:
            self.opened.add(item.link)
        self._came.set()

    def wait(self, seconds):
        """Wait until something comes, so many seconds at most."""
        self._came.wait(seconds)
        self._came.clear()

"""A serial port without a rate in its address finds it."""

import numpy as np
import pytest

from skincal.devices.robotiq import START_BYTES, STOP_BYTES, RobotiqHandshake
from skincal.model.readings import Stream
from skincal.streams import opening
from skincal.streams.decoders.auto_detect import LinkDecoder, make_decoder
from skincal.streams.opening import HandshakeLink
from skincal.streams.transports import baud_search
from skincal.streams.transports.baud_search import BAUD_RATE_TRIAL_MAX_S, BAUD_RATES, BaudSearchLink, DeviceBaudLink
from tests.skincal.streams.maker_records import VECTORS

BOTA, ROBOTIQ = VECTORS["bota"].data, VECTORS["robotiq"].data
TEXT = b"1.5,2.5,3.5,0.1,0.2,0.3\n"


class Line:
    """A port whose device speaks at one rate: at any other its bytes are noise."""

    def __init__(self, record, baud):
        self._record, self._baud, self._now = record, baud, BAUD_RATES[0]
        self._rng = np.random.default_rng(1)
        self.trials = [BAUD_RATES[0]]

    def read(self, _timeout_s):
        data = self._record * 10
        return data if self._now == self._baud else self._rng.integers(0, 256, len(data), np.uint8).tobytes()

    def set_baud(self, baud):
        self._now = baud
        self.trials.append(baud)

    def write(self, data):
        pass

    def close(self):
        pass


@pytest.fixture
def clock(monkeypatch):
    """A clock that goes on by 0.1 s with each look at it."""
    now = [0.0]

    def tick():
        now[0] += 0.1
        return now[0]

    monkeypatch.setattr(baud_search.time, "monotonic", tick)


@pytest.mark.parametrize(("record", "baud"), [(BOTA, 460800), (ROBOTIQ, 19200), (TEXT, 115200), (TEXT, 1_000_000)])
@pytest.mark.usefixtures("clock")
def test_the_rate_is_found_and_kept(record, baud):
    line = Line(record, baud)
    link = BaudSearchLink(line, (Stream.WRENCH,))
    data = b"".join(link.read(0.1) for _ in range(200))
    assert (link.found, link.baud) == (True, baud)
    assert line.trials == list(BAUD_RATES[: BAUD_RATES.index(baud) + 1])
    decoder = LinkDecoder("auto", None, (Stream.WRENCH,))
    readings = sum(
        len(batch.seq) for at in range(0, len(data), 500) for _, batch in decoder.feed(data[at : at + 500], at * 1_000_000)
    )
    assert readings > 1000  # what is handed on, noise and all, gives the readings


@pytest.mark.usefixtures("clock")
def test_the_search_goes_round_and_skin_of_any_width_is_not_found_in_noise():
    line = Line(BOTA, 1)
    link = BaudSearchLink(line, tuple(Stream))
    for _ in range(int(2 * len(BAUD_RATES) * BAUD_RATE_TRIAL_MAX_S / 0.1)):
        link.read(0.1)
    assert not link.found
    assert line.trials[: len(BAUD_RATES) + 1] == [*BAUD_RATES, BAUD_RATES[0]]


@pytest.mark.parametrize("record", [b"x0y0=12 x0y1=13 x0y2=14\r\n", b"waiting for the sensor\n"])
@pytest.mark.usefixtures("clock")
def test_clean_text_is_no_wrong_rate(record):
    line = Line(record, 460800)
    link = BaudSearchLink(line, (Stream.SKIN,))
    for _ in range(200):
        link.read(0.1)
    assert not link.found
    assert line.trials == [115200, 460800]


class StartedSensor(Line):
    """An FT 300 that streams after its start, at one rate, and is silent else; at a wrong rate it understands no byte."""

    def __init__(self, baud, *, streams):
        super().__init__(ROBOTIQ, baud)
        self._now, self._streams = 19200, streams
        self.trials = [19200]

    def read(self, timeout_s):
        return super().read(timeout_s) if self._streams else b""

    def write(self, data):
        if self._now == self._baud:
            self._streams = {START_BYTES: True, STOP_BYTES: False}[data]


@pytest.mark.parametrize("baud", [19200, 115200])
@pytest.mark.parametrize("streams", [False, True], ids=["stopped", "left streaming"])
def test_a_robotiq_of_either_rate_is_started_and_read(monkeypatch, baud, streams):
    now = [0.0]

    def tick():
        now[0] += 0.02
        return now[0]

    monkeypatch.setattr(baud_search.time, "monotonic", tick)
    assert opening.time is baud_search.time
    sensor = StartedSensor(baud, streams=streams)
    rates = (19200, 115200)
    link = HandshakeLink("robotiq:X", DeviceBaudLink(sensor, rates, "robotiq", (Stream.WRENCH,)), RobotiqHandshake())
    decoder = make_decoder("robotiq", None, (Stream.WRENCH,))
    for _ in range(300):
        decoder.feed(link.read(0.1))
    assert decoder.valid_records > 100
    assert sensor.trials == list(rates[: rates.index(baud) + 1])
    assert link.tried == tuple(sensor.trials)

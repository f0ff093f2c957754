"""Search of the baud rate of a serial port: the next rate is tried while there is no reading."""

from __future__ import annotations

import time
from typing import Protocol

from skincal.devices.family import AUTO_FORMAT
from skincal.devices.link import Link
from skincal.model.readings import Stream
from skincal.streams.decoders.auto_detect import LinkDecoder, make_decoder
from skincal.streams.decoders.line_forms import last_clean_line

BAUD_RATES = (115200, 460800, 19200, 1_000_000, 921600, 9600, 57600, 2_000_000)
"""In the order of the trials: boards, Bota, Robotiq, OptoForce, and other usual settings of boards."""
BAUD_RATE_TRIAL_MAX_S = 1.0
"""s of bytes at one rate. Text is believed after 0.3 s; a slow board sends ten readings."""
MIN_READINGS_AT_RIGHT_BAUD_RATE = 5
"""Readings that show the right rate, if they outnumber the losses: noise now and then holds a line with a number."""

CLEAN_TEXT_BYTES = 512
"""Last bytes that are clean text at the right rate alone, also if its lines give no reading."""


DEVICE_RATE_TRIAL_MAX_S = 1.2
"""s at one of a device's rates. A Robotiq is stopped and started every 0.3 s, and sends at once."""


class BaudPort(Link, Protocol):
    """A serial port whose rate can be changed."""

    def set_baud(self, baud: int) -> None:
        """Change the baud rate. Raises LinkError."""
        ...


class BaudSearchLink:
    """A serial port that finds its baud rate. All bytes are returned, since bytes that are no reading are counted as lost."""

    def __init__(self, port: BaudPort, carries: tuple[Stream, ...]) -> None:
        self._port, self._carries = port, carries
        self.write, self.close = port.write, port.close
        self.baud = BAUD_RATES[0]
        self.tried: tuple[int, ...] = (self.baud,)
        self.found = False
        self._restart_decoding()

    def _restart_decoding(self) -> None:
        self._decoder = LinkDecoder(AUTO_FORMAT, None, self._carries)
        self._since_s: float | None = None
        self._tail = b""
        self._readings = 0

    def read(self, timeout_s: float) -> bytes:
        data = self._port.read(timeout_s)
        if data and not self.found:
            self._look_at(data, time.monotonic())
        return data

    def _look_at(self, data: bytes, now_s: float) -> None:
        self._since_s = now_s if self._since_s is None else self._since_s
        self._tail = (self._tail + data)[-CLEAN_TEXT_BYTES:]
        self._readings += sum(len(batch.seq) for _, batch in self._decoder.feed(data, round(now_s * 1e9)))
        if self._readings >= MIN_READINGS_AT_RIGHT_BAUD_RATE and self._readings > self._decoder.current.counts.total():
            self.found = True
        elif now_s - self._since_s > BAUD_RATE_TRIAL_MAX_S and not last_clean_line(self._tail):
            self.baud = BAUD_RATES[(BAUD_RATES.index(self.baud) + 1) % len(BAUD_RATES)]
            self.tried = tuple(dict.fromkeys((*self.tried, self.baud)))
            self._port.set_baud(self.baud)
            self._restart_decoding()


class DeviceBaudLink:
    """A device that is known and may have been set to one of several baud rates: they are tried until it gives a reading.

    A device that must be started is silent at a wrong rate, so the next rate is also tried without bytes.
    """

    def __init__(self, port: BaudPort, rates: tuple[int, ...], format_name: str, carries: tuple[Stream, ...]) -> None:
        self._port, self._rates, self._format, self._carries = port, rates, format_name, carries
        self.write, self.close = port.write, port.close
        self.baud = rates[0]
        self.tried: tuple[int, ...] = (self.baud,)
        self.found = False
        self._begin_trial(time.monotonic())

    def _begin_trial(self, now_s: float) -> None:
        self._decoder = make_decoder(self._format, None, self._carries)
        self._since_s = now_s

    def read(self, timeout_s: float) -> bytes:
        data = self._port.read(timeout_s)
        if not self.found:
            self._look_at(data, time.monotonic())
        return data

    def _look_at(self, data: bytes, now_s: float) -> None:
        self._decoder.feed(data)
        self.found = self._decoder.valid_records > 0
        if not self.found and now_s - self._since_s > DEVICE_RATE_TRIAL_MAX_S:
            self.baud = self._rates[(self._rates.index(self.baud) + 1) % len(self._rates)]
            self.tried = tuple(dict.fromkeys((*self.tried, self.baud)))
            self._port.set_baud(self.baud)
            self._begin_trial(now_s)

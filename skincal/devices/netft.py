"""ATI RDT: force/torque records over UDP, as Net F/T, Ethernet Axia, Schunk FTN-Axia and OnRobot HEX (Ethernet) send them.

A request is `!HHI`: 1234 (hex), command, count. A record is `!III6i`: number of the record, number of the sensor's sample,
status, and six counts Fx Fy Fz Tx Ty Tz. Counts per unit, units, ranges and tool transform are on the sensor's page
(`netft_page.py`). Wrenches are handed on in the sensor's own frame. Sources: ATI manuals 9620-05 (Net F/T) and 9610-05
(Axia); public clients of the OptoForce (counts of 1/10000 N and 1/100000 N m).

The link hands on packets (`decoding.pack`): the page first, `PAGE`, then each datagram, `RECORDS`. The host asks again for
the stream after a second of silence: the sensor was switched off, or another program stole the stream, since a sensor has
one listener. Records carry no time in a known unit: they are dated by their numbers.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import replace
from itertools import accumulate
from typing import ClassVar

import numpy as np

from skincal.devices.decoding import (
    DEFAULT_UNITS,
    INVALID_READING_FLAG,
    SATURATED_READING_FLAG,
    FrameDecoder,
    FrameSplitter,
    pack,
    packet_splitter,
)
from skincal.devices.family import DeviceAddress, Family, Form, Handshake, Questions, Route, Vector
from skincal.devices.link import FailureKind, LinkError
from skincal.devices.netft_page import ALL_BITS, ANY_ERROR_BIT, SensorPage, StatusTable, given_page, keep_transform, read_page
from skincal.model.readings import Batch, Loss, Stream

REQUEST_STRUCT = struct.Struct("!HHI")
RECORD_STRUCT = struct.Struct("!III6i")
PACKET_DTYPE = np.dtype(
    [("kind", "u1"), ("size", "<u4"), ("number", ">u4"), ("sample", ">u4"), ("status", ">u4"), ("counts", ">i4", (6,))]
)
"""A datagram of one record, as a packet."""
MAGIC, STOP, STREAM_ON = 0x1234, 0, 2
PAGE, RECORDS = 1, 2
"""Kinds of packets."""
WEB_PAGE_MAX_BYTES = 65536
"""Bytes. Pages of Net F/T boxes have 3 to 10 kB."""
RECORD_NUMBER_MODULUS = 1 << 32
REORDERED_RECORD_MAX_STEPS_BACK = 32
"""A record at most this many numbers behind was overtaken on its way. Further behind, the sensor restarted."""
SAMPLES_REPEATED_MAX = 20
"""Records in a row with one number of the sensor's sample: then the sensor has stopped, though its box goes on."""


class RdtHandshake(Handshake):
    """Asks for the stream, and again when it ends."""

    silence_s = 1.0
    closing_bytes = REQUEST_STRUCT.pack(MAGIC, STOP, 0)

    def opening(self) -> bytes:
        return REQUEST_STRUCT.pack(MAGIC, STREAM_ON, 0)

    def on_silence(self) -> bytes:
        return self.opening()


class RdtDecoder(FrameDecoder):
    """Decodes RDT records in packets."""

    name: ClassVar[str] = "ATI RDT"
    starts_whole: ClassVar[bool] = True

    def __init__(self, channels: int | None, carries: tuple[Stream, ...]) -> None:
        super().__init__(channels, carries)
        self._page: SensorPage | None = None
        self._last: int | None = None
        self._total = 0
        self._sample: int | None = None
        """Number of the sensor's last sample."""
        self._samples_count = False
        """Whether the sensor numbers its samples: the number has changed."""
        self._repeats = 0
        """Records in a row that repeat a sample."""

    def _make_splitter(self) -> FrameSplitter:
        self._packets = packet_splitter(WEB_PAGE_MAX_BYTES)
        return self._packets

    def feed_many(self, chunks: Sequence[bytes]) -> tuple[Batch, list[int]] | None:
        """Decode chunks of whole datagrams of one good record each, with no number missing. Else take nothing."""
        page, last, size = self._page, self._last, PACKET_DTYPE.itemsize
        is_usual = page is not None and page.own_from_reported is None and not self._status and Stream.WRENCH in self._widths
        is_whole = not self._packets.has_partial_frame and all(chunk and not len(chunk) % size for chunk in chunks)
        if page is None or last is None or not is_usual or not is_whole:
            return None
        records = np.frombuffer(b"".join(chunks), PACKET_DTYPE)
        numbers, samples = records["number"].astype(np.int64), records["sample"].astype(np.int64)
        if (
            (records["kind"] != RECORDS).any()
            or (records["size"] != RECORD_STRUCT.size).any()
            or records["status"].any()
            or (np.diff(numbers, prepend=last) % RECORD_NUMBER_MODULUS != 1).any()
            or self._sample is None
            or (np.diff(samples, prepend=self._sample) == 0).any()
        ):
            return None
        values = records["counts"] / np.repeat([page.per_newton, page.per_newton_metre], 3)
        if page.limits and (np.abs(values) > page.limits).any():
            return None
        totals = self._total + 1 + np.arange(len(records))
        self._last, self._total = int(numbers[-1]), int(totals[-1])
        self._sample, self._samples_count, self._repeats = int(samples[-1]), True, 0
        self.valid_records += len(records)
        found = self._batch(Stream.WRENCH, totals, np.full(len(records), math.nan), values)
        return found, list(accumulate(len(chunk) // size for chunk in chunks))

    def _decode(self, frame: bytes) -> Loss | None:
        kind, payload = frame[0], frame[1:]
        if kind == PAGE:
            self._use_page(payload)
            return None
        if kind != RECORDS:
            return Loss.UNREADABLE
        if not payload or len(payload) % RECORD_STRUCT.size:
            self._problem = f"Datagrams of {len(payload)} bytes arrive where records have {RECORD_STRUCT.size}"
            return Loss.BAD_WIDTH
        problems = [self._record(record) for record in RECORD_STRUCT.iter_unpack(payload)]
        return next((problem for problem in problems if problem), None)

    def _use_page(self, payload: bytes) -> None:
        try:
            self._page = page = read_page(payload)
        except ValueError as error:
            self._problem = f"The sensor's counts are not known: {error}"
            return
        self._problem = page.notice
        words = [DEFAULT_UNITS[Stream.WRENCH], page.frame_words, page.settings]
        self.units[Stream.WRENCH] = ", ".join(filter(None, words))

    def _record(self, record: tuple[int, ...]) -> Loss | None:
        number, sample, status, *counts = record
        page = self._page
        if page is None:
            return Loss.UNREADABLE
        if not self._is_new(number):
            return Loss.LATE
        self.valid_records += 1
        flags = 0
        if status != 0 or self._status:
            flags = self._read_status(status, page.table)
        if self._repeats_sample(sample):
            return Loss.REPEATED
        values = [count / page.per_newton for count in counts[:3]] + [count / page.per_newton_metre for count in counts[3:]]
        if page.own_from_reported is not None:
            values = (page.own_from_reported @ values).tolist()
        if page.limits and any(abs(value) > limit for value, limit in zip(values, page.limits, strict=True)):
            flags |= SATURATED_READING_FLAG
            self._status = self._status or "The force or torque is beyond the range on the sensor's page"
        return self._add(Stream.WRENCH, self._total, math.nan, values, flags)

    def _repeats_sample(self, sample: int) -> bool:
        """Check whether a record repeats the sensor's last sample; a sensor that never numbers its samples repeats none."""
        last, self._sample = self._sample, sample
        if sample != last:
            self._samples_count = self._samples_count or last is not None
            self._repeats = 0
            return False
        if not self._samples_count:
            return False
        self._repeats += 1
        if self._repeats >= SAMPLES_REPEATED_MAX:
            self._status = "The sensor has stopped, and its box repeats the last reading: switch the sensor off and on"
        return True

    def _is_new(self, number: int) -> bool:
        """Count the numbers missing before a record; return False for one that was overtaken or came twice."""
        last, step = self._last, 0 if self._last is None else (number - self._last) % RECORD_NUMBER_MODULUS
        if last is not None and (step == 0 or RECORD_NUMBER_MODULUS - step <= REORDERED_RECORD_MAX_STEPS_BACK):
            return False
        self._last = number
        if last is None or step >= RECORD_NUMBER_MODULUS // 2:
            # The sensor started or restarted; the clock of its numbers sees this.
            self._total = number
            return True
        self._count_missing(step - 1)
        self._total += step
        return True

    def _read_status(self, status: int, table: StatusTable) -> int:
        """Keep a status word as a sentence; return the flags of the reading."""
        said = status & ~table.unnamed
        bits = [bit for bit in range(32) if said >> bit & 1]
        words = [table.words.get(bit, f"bit {bit}, see its manual") for bit in bits]
        is_silent = not said and not status & ANY_ERROR_BIT
        self._status = "" if is_silent else f"The sensor says (status {status:08X}): {', '.join(words) or 'an error'}"
        if status & table.saturated:
            return SATURATED_READING_FLAG
        return (
            INVALID_READING_FLAG if status & ~table.harmless or (status == ANY_ERROR_BIT and table.harmless != ALL_BITS) else 0
        )


COUNTS_ADVICE = "give the counts for each N and each N m (not N mm) of its data sheet, such as ?cpf=1000000&cpt=1000000"
HEX_COUNTS = 10_000.0, 100_000.0
"""Counts for each N and N m of every OnRobot HEX."""
PRODUCT_OF_OPTION = {"hex": "OnRobot HEX", "axia": "Axia", "netft": "Net F/T"}
"""By the option `device`."""


def _with_page(address: DeviceAddress, questions: Questions) -> DeviceAddress:
    """Add the page with the counts: made of the address's options, or asked from the sensor."""
    options = address.options
    product = PRODUCT_OF_OPTION.get(options.get("device", "netft"))
    if product is None:
        raise LinkError(FailureKind.ADDRESS, f"{address.text}: device is {options['device']}; expected netft, axia or hex.")
    force, torque = HEX_COUNTS if options.get("device") == "hex" else (0.0, 0.0)
    try:
        force, torque = float(options.get("cpf", force)), float(options.get("cpt", torque))
        port = int(options.get("page", 80))
        if not 1 <= port <= 65535:
            raise ValueError(f"page is {port}, not a port in 1 ... 65535")
    except ValueError as error:
        raise LinkError(FailureKind.ADDRESS, f"{address.text}: {error}; {COUNTS_ADVICE}.") from error
    if options.get("transform", "undo") not in ("undo", "keep"):
        sentence = f"{address.text}: transform is {options['transform']}; expected undo or keep."
        raise LinkError(FailureKind.ADDRESS, sentence)
    if force and torque:
        page = given_page(force, torque, product)
    else:
        where = f"{address.text} (its page, http://{address.host}:{port}/netftapi2.xml)"
        try:
            page = questions.get_page(where, address.host, port, "/netftapi2.xml")[:WEB_PAGE_MAX_BYTES]
        except LinkError as error:
            raise LinkError(error.kind, f"{error} Or {COUNTS_ADVICE}.") from error
    try:
        read_page(page)
    except ValueError as error:
        raise LinkError(FailureKind.OTHER, f"{address.text}: {error}; {COUNTS_ADVICE}.") from error
    if options.get("transform") == "keep":
        page = keep_transform(page)[:WEB_PAGE_MAX_BYTES]
    return replace(address, first_bytes=pack(PAGE, page))


_RECORD_BYTES = bytes.fromhex("00000001000012670000000000BC4B20FFA97B9005D8E3200001E078FFED2BB000001388")
_RECORD_WRENCH = (12.34, -5.67, 98.1, 0.123, -1.234, 0.005)

DEVICE_FAMILY = Family(
    routes=(
        Route(
            usage="netft://192.168.1.1",
            form=Form.HOST,
            transport="udp",
            format="rdt",
            port=49152,
            options=("cpf", "cpt", "device", "page", "transform"),
            handshake=lambda _: RdtHandshake(),
            needs_every_byte=True,
            message_kind=RECORDS,
            prepare=_with_page,
        ),
    ),
    decoders={"rdt": RdtDecoder},
    vectors=(
        Vector(
            "rdt",
            (Stream.WRENCH,),
            pack(PAGE, given_page(1e6, 1e6, "Net F/T")) + pack(RECORDS, _RECORD_BYTES),
            (_RECORD_WRENCH,),
        ),
        Vector(
            "rdt",
            (Stream.WRENCH,),
            pack(PAGE, given_page(1e4, 1e5, "OnRobot HEX"))
            + pack(RECORDS, bytes.fromhex("0000000100000001000000000001E208FFFF2284000EF8080000300CFFFE1DF8000001F4")),
            (_RECORD_WRENCH,),
        ),
    ),
)

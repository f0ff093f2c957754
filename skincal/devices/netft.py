"""ATI RDT: force/torque records over UDP, as Net F/T, Ethernet Axia, Schunk FTN-Axia and OnRobot HEX (Ethernet) send them.

A request is `!HHI`: 1234 (hex), command, count. A record is `!III6i`: number of the record, number of the sensor's sample,
status, and six counts Fx Fy Fz Tx Ty Tz. Counts per unit and the units stand on the sensor's page `netftapi2.xml`. Sources:
ATI manuals 9620-05 (Net F/T) and 9610-05 (Axia); public clients of the OptoForce (counts of 1/10000 N and 1/100000 N m).

The link hands on packets (`decoding.pack`): the page first, `PAGE`, then each datagram, `RECORDS`. The host asks again for
the stream after a second of silence: the sensor was switched off, or another program stole the stream, since a sensor has
one listener. Records carry no time in a known unit: they are dated by their numbers.
"""

from __future__ import annotations

import math
import re
import struct
from dataclasses import dataclass, replace
from typing import ClassVar

from skincal.devices.decoding import (
    INVALID_READING_FLAG,
    SATURATED_READING_FLAG,
    FrameDecoder,
    FrameSplitter,
    pack,
    packet_splitter,
)
from skincal.devices.family import DeviceAddress, Family, Form, Handshake, Questions, Route, Vector
from skincal.devices.link import FailureKind, LinkError
from skincal.model.readings import Loss, Stream

REQUEST_STRUCT = struct.Struct("!HHI")
RECORD_STRUCT = struct.Struct("!III6i")
MAGIC, STOP, STREAM_ON = 0x1234, 0, 2
PAGE, RECORDS = 1, 2
"""Kinds of packets."""
WEB_PAGE_MAX_BYTES = 65536
"""Bytes. Pages of Net F/T boxes have 3 to 10 kB."""
RECORD_NUMBER_MODULUS = 1 << 32
REORDERED_RECORD_MAX_STEPS_BACK = 32
"""A record at most this many numbers behind was overtaken on its way. Further behind, the sensor restarted."""
FORCE_UNITS = {"n": 1.0, "kn": 1e3, "lb": 4.4482216152605, "klb": 4448.2216152605, "kg": 9.80665, "g": 9.80665e-3}
"""N, by the unit's name in small letters without marks and the f of force."""
TORQUE_UNITS = {
    "nm": 1.0,
    "nmm": 1e-3,
    "knm": 1e3,
    "lbin": 0.1129848290276167,
    "lbft": 1.3558179483314004,
    "kgcm": 0.0980665,
    "kgm": 9.80665,
}
"""N m, by the unit's name in the same form."""
ANY_ERROR_BIT = 1 << 31
MONITOR_BIT = 1 << 16


@dataclass(frozen=True, slots=True)
class StatusTable:
    """Meaning of the bits of a status word."""

    saturated: int
    """Bits of a force or torque beyond the range."""
    harmless: int
    """Bits that are no error."""
    words: dict[int, str]
    """Sentences by the number of the bit."""


NET_FT_STATUS = StatusTable(
    1 << 17,
    MONITOR_BIT | ANY_ERROR_BIT,
    {16: "a monitored condition was met", 17: "saturated: the force or torque is beyond the sensor's range"},
)
AXIA_STATUS = StatusTable(
    1 << 27 | 1 << 30,
    MONITOR_BIT | ANY_ERROR_BIT | 1 << 3,
    {
        0: "its temperature is out of range",
        1: "its supply voltage is out of range",
        2: "a strain gage is broken",
        3: "busy",
        5: "an error of its hardware",
        7: "its calibration cannot be read",
        16: "a monitored condition was met",
        27: "a strain gage is beyond its range",
        28: "it sends simulated readings",
        29: "its calibration has a wrong checksum",
        30: "the force or torque is beyond its range",
    },
)
ALL_BITS = (1 << 32) - 1
HEX_STATUS = StatusTable(0, ALL_BITS, {})
"""No public text of OnRobot explains its bits: they are shown, and no reading is rejected for them."""


@dataclass(frozen=True, slots=True)
class SensorPage:
    """A sensor's counts per unit and table of status bits."""

    per_newton: float
    per_newton_metre: float
    product: str
    table: StatusTable


def read_page(page: bytes) -> SensorPage:
    """Read `netftapi2.xml`.

    Raises
    ------
    ValueError
        It lacks the counts, or has a unit that is not known; the message is a sentence without an end.
    """
    text = page.decode("utf-8", "replace")
    product = _field(text, "prodname") or "Net F/T"
    table = HEX_STATUS if "HEX" in product else AXIA_STATUS if "Axia" in product else NET_FT_STATUS
    scales: list[float] = []
    for counts, unit, units in (("cfgcpf", "scfgfu", FORCE_UNITS), ("cfgcpt", "scfgtu", TORQUE_UNITS)):
        name = re.sub("[^a-z]", "", (_field(text, unit) or "N").lower()).replace("lbf", "lb").replace("kgf", "kg")
        if unit == "scfgtu" and not _field(text, unit):
            name = "nm"
        size = units.get(name)
        number = _number(_field(text, counts))
        if size is None:
            raise ValueError(f"its page names the unit {_field(text, unit)[:20]!r}; expected one of {', '.join(units)}")
        if not 0 < number < 1 << 32:
            raise ValueError(f"its page gives no {counts}, the counts for each unit")
        scales.append(number / size)
    return SensorPage(scales[0], scales[1], product[:60], table)


def given_page(per_newton: float, per_newton_metre: float, product: str) -> bytes:
    """Build the page of a sensor that serves none, from the counts of its data sheet."""
    return (
        f"<netft><prodname>{product}</prodname><cfgcpf>{per_newton:.17g}</cfgcpf><scfgfu>N</scfgfu>"
        f"<cfgcpt>{per_newton_metre:.17g}</cfgcpt><scfgtu>Nm</scfgtu></netft>"
    ).encode()


def _field(text: str, name: str) -> str:
    # Not an XML parser: a stranger's page may hold entities without end.
    found = re.search(f"<{name}>([^<]{{1,80}})</{name}>", text)
    return found[1].strip() if found else ""


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


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

    def _make_splitter(self) -> FrameSplitter:
        return packet_splitter(WEB_PAGE_MAX_BYTES)

    def _decode(self, frame: bytes) -> Loss | None:
        kind, payload = frame[0], frame[1:]
        if kind == PAGE:
            try:
                self._page = read_page(payload)
            except ValueError as error:
                self._problem = f"The sensor's counts are not known: {error}"
            return None
        if kind != RECORDS:
            return Loss.UNREADABLE
        if not payload or len(payload) % RECORD_STRUCT.size:
            self._problem = f"Datagrams of {len(payload)} bytes arrive where records have {RECORD_STRUCT.size}"
            return Loss.BAD_WIDTH
        problems = [self._record(record) for record in RECORD_STRUCT.iter_unpack(payload)]
        return next((problem for problem in problems if problem), None)

    def _record(self, record: tuple[int, ...]) -> Loss | None:
        number, _, status, *counts = record
        if self._page is None:
            return Loss.UNREADABLE
        if not self._is_new(number):
            return Loss.LATE
        self.valid_records += 1
        page, flags = self._page, 0
        if status != 0 or self._status:
            flags = self._read_status(status, page.table)
        values = [count / page.per_newton for count in counts[:3]] + [count / page.per_newton_metre for count in counts[3:]]
        return self._add(Stream.WRENCH, self._total, math.nan, values, flags)

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
        bits = [bit for bit in range(31) if status >> bit & 1 and bit != 3]
        words = [table.words.get(bit, f"bit {bit}, see its manual") for bit in bits]
        self._status = f"The sensor says (status {status:08X}): {', '.join(words) or 'an error'}" if status & ~8 else ""
        if status & table.saturated:
            return SATURATED_READING_FLAG
        return (
            INVALID_READING_FLAG if status & ~table.harmless or (status == ANY_ERROR_BIT and table.harmless != ALL_BITS) else 0
        )


COUNTS_ADVICE = "give the counts for each N and N m of its data sheet, such as ?cpf=1000000&cpt=1000000"
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
    return replace(address, first_bytes=pack(PAGE, page))


_RECORD_BYTES = bytes.fromhex("00000001000012670000000000BC4B20FFA97B9005D8E3200001E078FFED2BB000001388")
_RECORD_WRENCH = (12.34, -5.67, 98.1, 0.123, -1.234, 0.005)

FAMILY = Family(
    routes=(
        Route(
            usage="netft://192.168.1.1",
            form=Form.HOST,
            transport="udp",
            format="rdt",
            port=49152,
            options=("cpf", "cpt", "device", "page"),
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

"""ATI RDT: force/torque records over UDP, as Net F/T, Ethernet Axia, Schunk FTN-Axia and OnRobot HEX (Ethernet) send them.

A request is `!HHI`: 1234 (hex), command, count. A record is `!III6i`: number of the record, number of the sensor's sample,
status, and six counts Fx Fy Fz Tx Ty Tz. Counts per unit and the units stand on the sensor's page `netftapi2.xml`. Sources:
ATI manuals 9620-05 (Net F/T) and 9610-05 (Axia); public clients of the OptoForce (counts of 1/10000 N and 1/100000 N m).

The link hands on packets (`framing.pack`): the page first, `PAGE`, then each datagram, `RECORDS`. The host asks again for
the stream after a second of silence: the sensor was switched off, or another program stole the stream, since a sensor has
one listener. Records carry no time in a known unit: they are dated by their numbers.
"""

from __future__ import annotations

import math
import re
import struct
from dataclasses import dataclass
from typing import ClassVar

from skincal.model.readings import Loss, Stream
from skincal.streams.decoders.base import INVALID_BIT, SATURATED_BIT, PieceDecoder, Pieces
from skincal.streams.decoders.dialogue import Dialogue
from skincal.streams.decoders.framing import Packets

REQUEST = struct.Struct("!HHI")
RECORD = struct.Struct("!III6i")
MAGIC, STOP, STREAM_ON = 0x1234, 0, 2
PAGE, RECORDS = 1, 2
"""Kinds of packets."""
PAGE_MAX = 65536
"""Bytes. Pages of Net F/T boxes have 3 to 10 kB."""
NUMBERS = 1 << 32
REORDERED = 32
"""A record this little behind was overtaken on its way; further behind, the sensor began anew."""
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
"""N m, likewise."""
ANY = 1 << 31
LATCH = 1 << 16


@dataclass(frozen=True, slots=True)
class StatusTable:
    """What the bits of a status word say."""

    saturated: int
    """Any of them: beyond the range."""
    harmless: int
    """None of them is an error."""
    words: dict[int, str]
    """By the number of the bit."""


NET_FT = StatusTable(
    1 << 17,
    LATCH | ANY,
    {16: "a monitored condition was met", 17: "saturated: the force or torque is beyond the sensor's range"},
)
AXIA = StatusTable(
    1 << 27 | 1 << 30,
    LATCH | ANY | 1 << 3,
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
HEX = StatusTable(0, NUMBERS - 1, {})
"""OnRobot says in no public text what its bits mean: they are shown, and no reading is left out for them."""


@dataclass(frozen=True, slots=True)
class SensorPage:
    """What a sensor says of its counts."""

    per_newton: float
    per_newton_metre: float
    product: str
    table: StatusTable


def read_page(page: bytes) -> SensorPage:
    """Return what `netftapi2.xml` says.

    Raises
    ------
    ValueError
        It lacks the counts, or has a unit that is not known; the message is a sentence without an end.
    """
    text = page.decode("utf-8", "replace")
    product = _field(text, "prodname") or "Net F/T"
    table = HEX if "HEX" in product else AXIA if "Axia" in product else NET_FT
    scales: list[float] = []
    for counts, unit, units in (("cfgcpf", "scfgfu", FORCE_UNITS), ("cfgcpt", "scfgtu", TORQUE_UNITS)):
        name = re.sub("[^a-z]", "", (_field(text, unit) or "N").lower()).replace("lbf", "lb").replace("kgf", "kg")
        if unit == "scfgtu" and not _field(text, unit):
            name = "nm"
        size = units.get(name)
        number = _number(_field(text, counts))
        if size is None:
            raise ValueError(f"its page names the unit {_field(text, unit)[:20]!r}; expected one of {', '.join(units)}")
        if not 0 < number < NUMBERS:
            raise ValueError(f"its page gives no {counts}, the counts for each unit")
        scales.append(number / size)
    return SensorPage(scales[0], scales[1], product[:60], table)


def given_page(per_newton: float, per_newton_metre: float, product: str) -> bytes:
    """Return a page for a sensor that serves none, from what the operator knows of it."""
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


class RdtDialogue(Dialogue):
    """Asks for the stream, and again when it ends."""

    silence_s = 1.0
    farewell = REQUEST.pack(MAGIC, STOP, 0)

    def opening(self) -> bytes:
        """See `Dialogue`."""
        return REQUEST.pack(MAGIC, STREAM_ON, 0)

    def on_silence(self) -> bytes:
        """See `Dialogue`."""
        return self.opening()


class RdtDecoder(PieceDecoder):
    """Decodes RDT records in packets."""

    name: ClassVar[str] = "ATI RDT"

    def __init__(self, channels: int | None, carries: tuple[Stream, ...]) -> None:
        super().__init__(channels, carries)
        self._first = False  # A datagram comes whole or not at all.
        self._page: SensorPage | None = None
        self._last: int | None = None
        self._total = 0
        self._state = ""

    def _make_splitter(self) -> Pieces:
        return Packets(PAGE_MAX)

    @property
    def note(self) -> str:
        """See `PieceDecoder`."""
        return self._state or self._collector.note

    def _decode(self, piece: bytes) -> Loss | None:
        kind, payload = piece[0], piece[1:]
        if kind == PAGE:
            try:
                self._page = read_page(payload)
            except ValueError as error:
                self._collector.note = f"The sensor's counts are not known: {error}"
            return None
        if kind != RECORDS:
            return Loss.UNREADABLE
        if not payload or len(payload) % RECORD.size:
            self._collector.note = f"Datagrams of {len(payload)} bytes arrive where records have {RECORD.size}"
            return Loss.BAD_WIDTH
        problems = [self._record(record) for record in RECORD.iter_unpack(payload)]
        return next((problem for problem in problems if problem), None)

    def _record(self, record: tuple[int, ...]) -> Loss | None:
        number, _, status, *counts = record
        if self._page is None:
            return Loss.UNREADABLE
        if not self._counted(number):
            return Loss.LATE
        self.good += 1
        page, flags = self._page, 0
        if status != 0 or self._state:
            flags = self._read_status(status, page.table)
        values = [count / page.per_newton for count in counts[:3]] + [count / page.per_newton_metre for count in counts[3:]]
        return self._collector.add(Stream.WRENCH, self._total, math.nan, values, flags)

    def _counted(self, number: int) -> bool:
        """Count what is missing before a record; return False for one that was overtaken or came twice."""
        last, step = self._last, 0 if self._last is None else (number - self._last) % NUMBERS
        if last is not None and (step == 0 or NUMBERS - step <= REORDERED):
            return False
        self._last = number
        if last is None or step >= NUMBERS // 2:
            # It began, or began anew with its numbers, which those who date its records see.
            self._total = number
            return True
        if step > 1:
            self.counts[Loss.MISSING] += step - 1
        self._total += step
        return True

    def _read_status(self, status: int, table: StatusTable) -> int:
        """Keep what a status says as a sentence; return what it means for the reading."""
        bits = [bit for bit in range(31) if status >> bit & 1 and bit != 3]
        words = [table.words.get(bit, f"bit {bit}, see its manual") for bit in bits]
        self._state = f"The sensor says (status {status:08X}): {', '.join(words) or 'an error'}" if status & ~8 else ""
        if status & table.saturated:
            return SATURATED_BIT
        return INVALID_BIT if status & ~table.harmless or (status == ANY and table.harmless != NUMBERS - 1) else 0

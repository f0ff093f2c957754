"""What a session's files hold: JSON documents that come back bit for bit, and messages as ROS 2 writes them.

*Events* are what happened: a segment begins, a link opens or goes, the operator acts, the session is put down. *Notes* are
what was made of the bytes: outcomes of pokes, dead channels, counts of readings. Floats are written by their shortest exact
decimals; NaN is null, and what is infinite is a word.

Bytes and decoded readings are messages in CDR, little-endian, made by hand. Each begins with four bytes that say how it is
encoded; every number is aligned to its size, counted from behind these four bytes. Source: OMG DDS-XTypes 1.3, 7.4.3 (plain
CDR), and ROS 2's message definitions, which travel in the file.

The small file beside each segment holds its events and notes, one checked line each. Opening a session reads nothing else.

A line is a JSON array `["CHECKSUM", ITEMS, KEY, DOCUMENT]`. ITEMS is how many items of the segment lie in its MCAP file for
sure: that file is written first. KEY names the poke that the document is about; right behind a line of the same key, it takes
that line's place. A line without KEY and DOCUMENT says only how many items there are, and one with the word "closed" that no
more come. CHECKSUM is the CRC-32, in hexadecimal, of what follows it in the line and of all lines before, so that no line can
be changed, lost or moved unseen.
"""

from __future__ import annotations

import math
import os
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any, TypeAlias, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from skincal.contacts.detector import Doubt
from skincal.contacts.gates import FinishedPress, StillMean
from skincal.contacts.outcome import Contact, Outcome, Reason, Rejection
from skincal.contacts.tare import Tare
from skincal.devices.plain import address_for_journal
from skincal.geometry import FloatArray, IntArray
from skincal.model.actions import Stamped, from_json, to_json
from skincal.model.errors import InputError
from skincal.model.given import parse_json, read_regular
from skincal.model.readings import Chunk, LinkEvent, LinkHealth, LinkState, Loss, SideReading, Stream, joined
from skincal.model.scene import ContactSettings, with_thresholds
from skincal.model.tables import shown
from skincal.streams.links import LinkSpec

MAX_LINKS = len(Stream)
"""Links of a session: each carries another stream."""
_LINE_END = b"]\n"
_CHECKSUM_HEAD_BYTES = 12
"""Bytes before what the checksum covers: `["`, eight digits, `",`."""
MAX_LINES_BYTES = 64 << 20
"""Bytes of the lines of a segment, which lasts five minutes: ten thousand pokes have 15 MB."""
_TOTALS, _NO_KEY, _CLOSED = b'"totals"', b'""', b'"closed"'
JOURNAL_FORMAT = 4
"""Version of the folder's form; a reader refuses a newer one. 1 had no notes, 2 no lines beside the segments, and up to 3 each
streamed arm pose was named by its rounded angles."""
FORMAT_WITH_NOTES = 2
FORMAT_WITH_GROUPED_POSES = 4
_INTEGER_ARRAYS = ("channels",)
"""Arrays of whole numbers; all others are float."""
_OPTIONAL_FIELDS = ("still", "link_from_sensor", "after", "force", "moment", "thresholds")
"""What may be missing; elsewhere null is a float that is none."""
SECONDS_MAX = 0x7FFFFFFF
"""s. The seconds of ROS 2 end in 2038; a clock that is set wrong must not stop a recording."""
_CDR_HEADER = b"\x00\x01\x00\x00"
_SCHEMA_SEPARATOR = "=" * 80
_HEADER = (
    f"{_SCHEMA_SEPARATOR}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    f"{_SCHEMA_SEPARATOR}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)
MESSAGE_SCHEMAS: dict[str, str] = {
    "skincal_msgs/msg/Chunk": "uint64 host_ns\nuint8[] data\n",
    "geometry_msgs/msg/WrenchStamped": (
        "std_msgs/Header header\ngeometry_msgs/Wrench wrench\n"
        f"{_SCHEMA_SEPARATOR}\nMSG: geometry_msgs/Wrench\ngeometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque\n"
        f"{_SCHEMA_SEPARATOR}\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n{_HEADER}"
    ),
    "skincal_msgs/msg/Taxels": f"std_msgs/Header header\nuint32 seq\nuint64 device_time_us\nfloat32[] values\n{_HEADER}",
    "sensor_msgs/msg/Temperature": f"std_msgs/Header header\nfloat64 temperature\nfloat64 variance\n{_HEADER}",
    "sensor_msgs/msg/JointState": (
        f"std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n{_HEADER}"
    ),
}
"""Definition of each message in `ros2msg`, by its name."""


@dataclass(frozen=True, slots=True)
class Taken:
    """Outcomes, each with what it may be judged by again, and the dead channels where they changed."""

    outcomes: Sequence[tuple[Outcome, Doubt | None]]
    dead: Mapping[int, str] | None = None
    """Every channel found to be dead, with the reason; None: as before."""


@dataclass(frozen=True, slots=True)
class LinkTotals:
    """Counts of one link over a whole session."""

    link: str
    format: str
    """Name of the format found last; empty while unknown."""
    readings: int
    losses: Mapping[Loss, int] = field(default_factory=dict[Loss, int])
    beside: Mapping[str, SideReading] = field(default_factory=dict[str, SideReading])
    """What else the device measured, by name and unit."""


@dataclass(frozen=True, slots=True)
class Totals:
    """Counts of a whole session, through all its segments."""

    links: tuple[LinkTotals, ...] = ()
    unpaired: int = 0
    """Skin frames that found no wrench."""

    def plus(self, health: Sequence[LinkHealth], unpaired: int) -> Totals:
        """Return the totals with the counts of one more segment."""
        links = {link.link: link for link in self.links}
        for new in health:
            old = links.get(new.link, LinkTotals(new.link, "", 0))
            losses = Counter(old.losses) + Counter(new.losses)
            beside = joined(old.beside, new.beside)
            links[new.link] = LinkTotals(new.link, new.format or old.format, old.readings + new.readings, losses, beside)
        return Totals(tuple(links.values()), self.unpaired + unpaired)


@dataclass(frozen=True, slots=True)
class WallClock:
    """Time of day by a monotonic clock, which restarts with the machine."""

    monotonic_s: float
    unix_s: float

    def at(self, monotonic_s: float) -> float:
        """Return the time of day, seconds since 1970; NaN for what lies before: another clock was meant."""
        return self.unix_s + monotonic_s - self.monotonic_s if monotonic_s >= self.monotonic_s else math.nan


@dataclass(frozen=True, slots=True)
class SegmentMark:
    """Here a segment begins, as its writer described it."""

    number: int
    host_ns: int
    links: tuple[LinkSpec, ...]
    format: int
    scene: str
    """Text of the scene's file."""
    digest: str | None
    """Of the scene's folder; None where the format has none."""
    continues: bool
    """Nothing happened but that the segment before was long enough; else the session was opened here to go on."""
    clock: WallClock | None = None
    """Of the machine that wrote it; None where it does not say."""


@dataclass(frozen=True, slots=True)
class Ending:
    """Here the session was put down in good order."""

    host_ns: int


Item: TypeAlias = Chunk | LinkEvent | Stamped | Ending
Note: TypeAlias = Taken | Totals
SessionEvent: TypeAlias = SegmentMark | LinkEvent | Stamped | Ending


def event_to_json(event: LinkEvent | Stamped | Ending) -> dict[str, Any]:
    """Return an event as a JSON object."""
    if isinstance(event, LinkEvent):
        body = {"type": "link", "link": event.link, "state": event.state.value, "text": event.text}
        body |= {key: value for key, value in (("dropped", event.dropped), ("tried", event.tried)) if value}
    elif isinstance(event, Ending):
        body = {"type": "end"}
    else:
        body = {"type": "action", **to_json(event.action)}
    return {"host_ns": event.host_ns, **body}


def note_to_json(note: Note) -> dict[str, Any]:
    """Return a note as a JSON object."""
    if isinstance(note, Totals):
        counts = {
            link.link: {
                "format": link.format,
                "readings": link.readings,
                "lost": {loss.name: count for loss, count in link.losses.items() if count},
                **({"beside": {name: _to_json(found) for name, found in link.beside.items()}} if link.beside else {}),
            }
            for link in note.links
        }
        return {"type": "totals", "links": counts, "unpaired": note.unpaired}
    dead = {} if note.dead is None else {"dead": {str(channel): why for channel, why in note.dead.items()}}
    return {"type": "taken", "outcomes": [_outcome_to_json(outcome, doubt) for outcome, doubt in note.outcomes], **dead}


def read_document(data: bytes, path: Path) -> SessionEvent | Note:
    """Return the event or the note of JSON bytes from the file `path`; raises what `from_document` raises."""
    try:
        document = parse_json(data)
    except ValueError as error:
        raise InputError(f"{path}: an event or note is no JSON ({error}); {_DAMAGED_OR_FOREIGN}.") from None
    if not isinstance(document, dict):
        raise InputError(f"{path}: an event or note is {shown(document)}; expected a table; {_DAMAGED_OR_FOREIGN}.")
    return from_document(cast("dict[str, Any]", document), path)


def from_document(document: Mapping[str, Any], path: Path) -> SessionEvent | Note:
    """Return the event or the note of a JSON object from the file `path`.

    Raises
    ------
    InputError
        It is of a newer version, or not one that skincal wrote.
    """
    kind = document.get("type")
    read = _READER_BY_TYPE.get(kind) if isinstance(kind, str) else None
    if read is None:
        raise InputError(
            f"{path}: has an event or note {shown(kind)}, which this version does not know; open it with a newer skincal."
        )
    body = {key: value for key, value in document.items() if key not in ("n", "type", "host_ns")}
    try:
        return read(_whole(document.get("host_ns", 0)), body)
    except (_NewerError, InputError) as error:
        raise InputError(f"{path}: {error}") from None
    except _PARSE_ERRORS as error:
        raise InputError(
            f"{path}: an event or note of kind {kind!r} does not fit ({error!r}); {_DAMAGED_OR_FOREIGN}."
        ) from None


_DAMAGED_OR_FOREIGN = "it is damaged, or another program wrote it"
_PARSE_ERRORS = (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError, AssertionError)
"""What the readers below raise on JSON that skincal never wrote."""
MAX_MEASURED_NUMBER = 1e12
"""Of forces, moments and responses, in their units: no sensor has more, and their squares stay numbers."""


class _NewerError(Exception):
    """A newer version wrote it."""


def _whole(value: object) -> int:
    if type(value) is not int:
        raise TypeError(f"{shown(value)} is no whole number")
    return value


def _text_of(value: object) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{shown(value)} is no text")
    return value


def _link_event(host_ns: int, body: Mapping[str, Any]) -> LinkEvent:
    dropped, tried = _whole(body.get("dropped", 0)), tuple(map(_whole, body.get("tried", ())))
    return LinkEvent(_text_of(body["link"]), host_ns, LinkState(body["state"]), _text_of(body["text"]), dropped, tried)


def _mark(host_ns: int, body: Mapping[str, Any]) -> SegmentMark:
    if _whole(body["format"]) > JOURNAL_FORMAT:
        raise _NewerError(f"was written by skincal {body['skincal']}, a newer one; expected format {JOURNAL_FORMAT} at most.")
    return SegmentMark(
        number=_whole(body["segment"]),
        host_ns=host_ns,
        links=_links(body["links"]),
        format=body["format"],
        scene=_text_of(body["scene"]),
        digest=None if body.get("scene_digest") is None else _text_of(body["scene_digest"]),
        continues=bool(body.get("continues", False)),
        clock=_clock(body),
    )


def _links(documents: Sequence[Mapping[str, Any]]) -> tuple[LinkSpec, ...]:
    """Return the links of a segment: all of their addresses are shown before any is connected."""
    if len(documents) > MAX_LINKS:
        raise InputError(
            f"has {len(documents)} links; expected at most {MAX_LINKS}, one for each stream; {_DAMAGED_OR_FOREIGN}."
        )
    return tuple(
        LinkSpec(
            _text_of(link["name"]),
            address_for_journal(_text_of(link["address"])),  # whoever wrote it: what a session names is not run
            tuple(map(Stream, link["carries"])),
            link["format"],
        )
        for link in documents
    )


def _clock(body: Mapping[str, Any]) -> WallClock | None:
    if "unix_ns" not in body or "monotonic_ns" not in body:
        return None
    return WallClock(_whole(body["monotonic_ns"]) / 1e9, _whole(body["unix_ns"]) / 1e9)


def link_to_json(link: LinkSpec) -> dict[str, Any]:
    """Convert a link's settings to a JSON object."""
    carries = [stream.value for stream in link.carries]
    return {"name": link.name, "address": address_for_journal(link.address), "carries": carries, "format": link.format}


def _taken_from_json(document: Mapping[str, Any]) -> Taken:
    dead = document.get("dead")
    return Taken(
        outcomes=[_outcome_from_json(entry) for entry in document["outcomes"]],
        dead=None if dead is None else {int(channel): _text_of(why) for channel, why in dead.items()},
    )


def _outcome_to_json(outcome: Outcome, doubt: Doubt | None) -> dict[str, Any]:
    document = {"is": "contact" if isinstance(outcome, Contact) else "rejection", **_to_json(outcome)}
    if doubt is not None:
        document["doubt"] = {"poke": _to_json(doubt.poke), "after": _to_json(doubt.after)}
    return document


def _outcome_from_json(document: Mapping[str, Any]) -> tuple[Outcome, Doubt | None]:
    doubt = _doubt(document.get("doubt"))
    if document["is"] == "contact":
        return _contact(document), doubt
    values = _values({key: value for key, value in document.items() if key not in ("is", "doubt")})
    values["reason"] = Reason[values["reason"]]
    return _checked(Rejection(**values)), doubt


def _contact(document: Mapping[str, Any]) -> Contact:
    # Written out, and not as `_values` does it: a session has ten thousand of these, and opening it waits for them.
    channels, responses = document["channels"], document["responses"]
    contact = Contact(
        poke=document["poke"],
        start_s=_number(document["start_s"]),
        end_s=_number(document["end_s"]),
        force=np.array(document["force"], dtype=np.float64),
        moment=np.array(document["moment"], dtype=np.float64),
        channels=np.array(channels, dtype=np.int64),
        responses=np.array(responses, dtype=np.float64),
        link_from_sensor=_pose(np.array(document["link_from_sensor"], dtype=np.float64).tobytes()),
        pose=document["pose"],
        tare_change=_number(document["tare_change"]),
        final=document["final"],
    )
    # In plain numbers, which is ten times quicker than in arrays.
    numbers = (*document["force"], *document["moment"], *responses, contact.start_s, contact.end_s)
    bounded = all(-MAX_MEASURED_NUMBER <= number <= MAX_MEASURED_NUMBER for number in numbers)  # false for NaN
    right = type(contact.poke) is int and type(contact.pose) is str and type(contact.final) is bool
    right &= 0 < contact.poke < MAX_POKE_NUMBER and contact.force.shape == contact.moment.shape == (3,)
    right &= len(channels) == len(responses) > 0 and channels == sorted(set(channels)) and min(responses) > 0
    if not right or not bounded or not any(document["force"]):
        raise ValueError(f"poke {shown(contact.poke)} is none that was measured")
    return contact


MAX_POSE_M = 1e3
"""m. Of a pose's numbers: no sensor is a kilometre away."""
MAX_POKE_NUMBER = 1 << 31
"""Numbers of pokes end here: a poke a second would take a lifetime."""
_ARRAY_SHAPES = {"force": (3,), "moment": (3,), "wrench": (6,), "link_from_sensor": (4, 4)}
Checked = TypeVar("Checked", Rejection, FinishedPress, StillMean, Tare)


def _checked(value: Checked) -> Checked:
    """Check type and shape of each field, and return the value."""
    for item in fields(value):
        found: object = getattr(value, item.name)
        wanted = str(item.type)
        if found is None and wanted.endswith("| None"):
            continue
        if "Array" in wanted:
            shape = np.shape(cast("FloatArray", found))
            right = type(found) is np.ndarray and shape == _ARRAY_SHAPES.get(item.name, shape[:1])
        else:
            right = type(found).__name__ in {"float": ("float", "int")}.get(wanted, (wanted.removesuffix(" | None"),))
        if not right:
            raise TypeError(f"{item.name} is {shown(cast('object', found))}")
    return value


@lru_cache(maxsize=64)
def _pose(raw: bytes) -> FloatArray:
    """Return a pose, (4, 4), from its bytes: one array for all pokes in it, and not to be written to."""
    pose = np.frombuffer(raw).reshape(4, 4)
    if not np.abs(pose).max() < MAX_POSE_M:  # nor NaN
        raise ValueError("a pose is none of a robot")
    return pose


def _number(value: float | str | None) -> float:
    return math.nan if value is None else float(value)


def _doubt(document: Mapping[str, Any] | None) -> Doubt | None:
    if document is None:
        return None
    values = _values(document["poke"])
    still = values["still"]
    before = _tare(document["poke"]["before"])
    assert before is not None
    values |= {"before": before, "still": None if still is None else _checked(StillMean(**_values(still)))}
    if values.get("thresholds") is not None:
        values["thresholds"] = with_thresholds(ContactSettings(), values["thresholds"])
    return Doubt(_checked(FinishedPress(**values)), _tare(document["after"]))


def _tare(document: Mapping[str, Any] | None) -> Tare | None:
    # The skin's baseline has done its work in the poke's responses; hundreds of numbers stay out of the journal.
    return None if document is None else _checked(Tare(**_values(document), skin=np.empty(0)))


def _to_json(value: Any) -> Any:
    """Return a number, array, enum or frozen dataclass as JSON."""
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None if math.isnan(value) else str(float(value))
    if isinstance(value, np.ndarray):
        return [_to_json(row) for row in cast("list[Any]", value.tolist())]
    if isinstance(value, list):
        return [_to_json(item) for item in cast("list[Any]", value)]
    if isinstance(value, Reason):
        return value.name
    left_out = ("skin",) if isinstance(value, Tare) else ()
    return {item.name: _to_json(getattr(value, item.name)) for item in fields(value) if item.name not in left_out}


def _values(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a dataclass: lists as arrays, null as NaN where a float belongs."""
    return {key: _value(key, value) for key, value in document.items()}


def _value(key: str, value: Any) -> Any:
    if isinstance(value, list):
        # As a float, null becomes NaN and "inf" infinity.
        return np.array(value, dtype=np.int64 if key in _INTEGER_ARRAYS else np.float64)
    if value is None:
        return None if key in _OPTIONAL_FIELDS else math.nan
    if value in ("inf", "-inf"):
        return float(value)
    return value


def _totals_from_json(document: Mapping[str, Any]) -> Totals:
    def read(name: str, link: Mapping[str, Any]) -> LinkTotals:
        losses = {Loss[loss]: _whole(count) for loss, count in link["lost"].items()}
        beside = {_text_of(key): _side_reading(found) for key, found in link.get("beside", {}).items()}
        return LinkTotals(name, _text_of(link["format"]), _whole(link["readings"]), losses, beside)

    return Totals(tuple(read(name, link) for name, link in document["links"].items()), _whole(document["unpaired"]))


def _side_reading(document: Mapping[str, Any]) -> SideReading:
    return SideReading(*(_number(document[item.name]) for item in fields(SideReading)))


_READER_BY_TYPE: dict[str, Callable[[int, Mapping[str, Any]], SessionEvent | Note]] = {
    "taken": lambda _, body: _taken_from_json(body),
    "totals": lambda _, body: _totals_from_json(body),
    "link": _link_event,
    "action": lambda host_ns, body: Stamped(host_ns, from_json(body)),
    "end": lambda host_ns, _: Ending(host_ns),
    "segment": _mark,
}
"""By the word that says what kind an event or a note is."""


def encode_chunk(host_ns: int, data: bytes) -> bytes:
    """Return a `skincal_msgs/msg/Chunk`: when bytes arrived (host's monotonic clock, ns), and the bytes."""
    return _CDR_HEADER + struct.pack("<QI", host_ns, len(data)) + data


def decode_chunk(message: bytes) -> tuple[int, bytes]:
    """Return arrival (ns) and bytes of a `skincal_msgs/msg/Chunk`; InputError where it is none."""
    if len(message) < 16 or message[:4] != _CDR_HEADER:
        raise InputError("A chunk in the session is not encoded as expected; the session was written by another program.")
    host_ns, size = struct.unpack_from("<QI", message, 4)
    if len(message) != 16 + size:
        raise InputError(f"A chunk in the session has {len(message) - 16} bytes; expected {size}.")
    return int(host_ns), message[16:]


def encode_wrenches(unix_ns: IntArray, frame: str, wrenches: FloatArray) -> NDArray[np.uint8]:
    """Return a `geometry_msgs/msg/WrenchStamped` each, (n, bytes), of (n,) times and (n, 6) wrenches, N and N m."""
    body = _stamped(0, frame)
    alike = _CDR_HEADER + body + bytes(-len(body) % 8)
    messages = np.empty(len(wrenches), np.dtype([("alike", "u1", (len(alike),)), ("wrench", "<f8", (6,))]))
    messages["alike"], messages["wrench"] = np.frombuffer(alike, np.uint8), wrenches
    rows = messages.view(np.uint8).reshape(len(wrenches), -1)
    seconds, rest = np.divmod(unix_ns, 1_000_000_000)
    clock = np.column_stack([np.minimum(seconds, SECONDS_MAX), rest]).astype("<u4")
    rows[:, len(_CDR_HEADER) : len(_CDR_HEADER) + 8] = clock.view(np.uint8)
    return rows


def encode_taxels(unix_ns: int, frame: str, seq: int, device_us: int, values: FloatArray) -> bytes:
    """Return a `skincal_msgs/msg/Taxels` of (channels,) raw values."""
    body = _stamped(unix_ns, frame)
    body += bytes(-len(body) % 4) + struct.pack("<I", seq & 0xFFFFFFFF)
    body += bytes(-len(body) % 8) + struct.pack("<QI", device_us, len(values))
    return _CDR_HEADER + body + np.ascontiguousarray(values, dtype="<f4").tobytes()


def encode_joints(unix_ns: int, frame: str, names: Sequence[str], angles: FloatArray) -> bytes:
    """Return a `sensor_msgs/msg/JointState` of (joints,) angles, radians, without velocities and efforts."""
    body = _stamped(unix_ns, frame)
    body += bytes(-len(body) % 4) + struct.pack("<I", len(names))
    for name in names:
        body += bytes(-len(body) % 4) + _text(name)
    body += bytes(-len(body) % 4) + struct.pack("<I", len(angles))
    # CDR aligns where a number is written: an empty sequence has no padding behind its length.
    if len(angles):
        body += bytes(-len(body) % 8) + np.ascontiguousarray(angles, dtype="<f8").tobytes()
    return _CDR_HEADER + body + struct.pack("<II", 0, 0)


def encode_temperature(unix_ns: int, frame: str, celsius: float) -> bytes:
    """Return a `sensor_msgs/msg/Temperature`, degC, its variance 0, which stands for unknown."""
    body = _stamped(unix_ns, frame)
    return _CDR_HEADER + body + bytes(-len(body) % 8) + struct.pack("<dd", celsius, 0.0)


def _stamped(unix_ns: int, frame: str) -> bytes:
    seconds, rest = divmod(unix_ns, 1_000_000_000)
    return struct.pack("<iI", min(seconds, SECONDS_MAX), rest) + _text(frame)


def _text(text: str) -> bytes:
    # CDR counts the closing zero of a string.
    raw = text.encode() + b"\x00"
    return struct.pack("<I", len(raw)) + raw


def lines_path(segment: Path) -> Path:
    """Return the file of lines beside a segment's MCAP file."""
    return segment.with_suffix(".jsonl")


def key_of(note: Note | None) -> str:
    """Return the key of a note: a later note replaces an earlier one of the same key. Empty: nothing is replaced.

    The outcome of one poke replaces an earlier one of the same kind: a session that takes both is as if it had taken the
    second alone. What was a contact and is none any more leaves the steps of undo, so both are kept. Of counts the last count.
    """
    if isinstance(note, Totals):
        return "totals"
    if not isinstance(note, Taken) or note.dead is not None or len(note.outcomes) != 1:
        return ""
    outcome = note.outcomes[0][0]
    return f"{'contact' if isinstance(outcome, Contact) else 'rejection'} {outcome.poke}"


class LineWriter:
    """Appends lines to a file.

    Parameters
    ----------
    path : a file that does not exist yet, or the whole part of one that was read
    read : of that file
    """

    def __init__(self, path: Path, read: Lines | None = None) -> None:
        self._file = path.open("xb" if read is None else "r+b")
        self._sum = 0 if read is None else read.checksum
        self._file.seek(0, os.SEEK_END)

    def add(self, items: int, key: str, document: bytes) -> None:
        """Append a document, JSON."""
        self._add(b'%d,"%s",%s' % (items, key.encode(), document))

    def vouch(self, items: int) -> None:
        """Record the number of items that the MCAP file holds for sure."""
        self._add(b"%d" % items)

    def flush(self, *, sync: bool = False) -> None:
        """Hand everything to the system; with `sync` to the medium."""
        self._file.flush()
        if sync:
            os.fsync(self._file.fileno())

    def close(self, items: int) -> None:
        """Write the closing line, and close the file."""
        self._add(b"%d,%s" % (items, _CLOSED))
        self.flush(sync=True)
        self._file.close()

    def abandon(self) -> None:
        """Close the file without a closing line. Raises OSError: the disk refuses the buffer."""
        self._file.close()

    def _add(self, body: bytes) -> None:
        body += _LINE_END
        # Over all lines before it too: one that is lost or moved breaks the chain there.
        self._sum = zlib.crc32(body, self._sum)
        self._file.write(b'["%08x",%s' % (self._sum, body))


@dataclass(frozen=True, slots=True)
class Lines:
    """What a file of lines says, up to its first damage."""

    documents: tuple[bytes, ...]
    """JSON; without those that others replaced, and counts last."""
    items: int
    """How many items lie in the MCAP file for sure."""
    closed: bool
    """The closing line is there: no line is missing."""
    checksum: int
    size: int
    """Bytes of the part without damage."""
    lost: int
    """Bytes behind it."""


def read_lines(segment: Path) -> Lines | None:
    """Return the lines beside a segment; None where there are none, as in older sessions."""
    path = lines_path(segment)
    data = read_regular(path, MAX_LINES_BYTES) if path.exists() else b""
    kept: list[bytes] = []
    totals: list[bytes] = []
    body, last_key, checksum, size = b"0]\n", _NO_KEY, 0, 0
    # One by one up to the first that is damaged: a list of all could take more than the file by far.
    for line in BytesIO(data):
        found = zlib.crc32(line[_CHECKSUM_HEAD_BYTES:], checksum)
        if line[:_CHECKSUM_HEAD_BYTES] != b'["%08x",' % found:
            break
        body, checksum = line[_CHECKSUM_HEAD_BYTES:], found
        size += len(line)
        _, *rest = body.split(b",", 2)
        if len(rest) < 2:
            continue
        key, document = rest
        if key == _TOTALS:
            totals = [document]
            continue
        # The second outcome of a poke takes the place of the first, which is then never parsed.
        if key == last_key != _NO_KEY:
            kept.pop()
        kept.append(document)
        last_key = key
    documents = tuple(document[: -len(_LINE_END)] for document in kept + totals)
    try:
        items = int(body.split(b",")[0].removesuffix(_LINE_END))
    except ValueError:
        raise InputError(f"{path}: a line begins with no count of items; {_DAMAGED_OR_FOREIGN}.") from None
    return Lines(documents, items, body.endswith(_CLOSED + _LINE_END), checksum, size, len(data) - size) if data else None

"""Events and results of a session as JSON documents that come back bit for bit.

*Events* are inputs: a segment begins, a link opens or is lost, the operator acts, the session is closed. *Results* are computed
from the bytes: outcomes of pokes, dead channels, counts of readings.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias, cast

from skincal.contacts.outcome import Contact, Outcome, Rejection
from skincal.contacts.pose_delays import PoseDelays
from skincal.contacts.press import FinishedPress
from skincal.contacts.skin_condition import SkinCondition
from skincal.contacts.tare import Tare
from skincal.devices.plain import address_for_journal
from skincal.journal.line_file import TOTALS_KEY
from skincal.model.actions import TimedAction, action_from_json, action_to_json
from skincal.model.codec import PARSE_ERRORS, from_json, to_json
from skincal.model.errors import InputError
from skincal.model.given import parse_json
from skincal.model.readings import (
    Chunk,
    LinkEvent,
    LinkHealth,
    Loss,
    Outages,
    SideReading,
    Stream,
    merge_side_readings,
)
from skincal.model.scene import ContactSettings, with_thresholds
from skincal.model.tables import quoted
from skincal.streams.links import LinkSpec

JOURNAL_FORMAT_VERSION = 5
"""Version of the session folder; a reader refuses a newer one. Up to 3 a streamed arm pose was named by its rounded angles, up
to 4 every wrench was taken for one in the sensor's frame."""
FIRST_FORMAT_WITH_GROUPED_POSES = 4
FIRST_FORMAT_WITH_WRENCH_FRAMES = 5
MAX_LINKS = len(Stream)
"""Links of a session: each carries another stream."""
MAX_MEASURED_VALUE = 1e12
"""Of forces, moments and responses, in their units: no sensor has more, and their squares stay finite."""
MAX_POKE_NUMBER = 1 << 31
"""Largest number of a poke: one a second would take a lifetime."""
DAMAGED_OR_FOREIGN = "it is damaged, or another program wrote it"


@dataclass(frozen=True, slots=True)
class DetectorResult:
    """Outcomes of pokes, and the dead channels if they changed."""

    outcomes: Sequence[Outcome]
    dead: Mapping[int, str] | None = None
    """Every channel found to be dead, with the reason; `None`: as before."""


@dataclass(frozen=True, slots=True)
class LinkTotals:
    """Counts of one link over a whole session."""

    link: str
    format: str
    """Name of the format found last; empty while unknown."""
    readings: int
    losses: Mapping[Loss, int] = field(default_factory=dict[Loss, int])
    beside: Mapping[str, SideReading] = field(default_factory=dict[str, SideReading])
    """Other quantities of the device, by name and unit."""
    frames: tuple[str, ...] = ()
    """Frames that its messages named for the wrench."""
    outages: Outages = field(default_factory=Outages)


@dataclass(frozen=True, slots=True)
class Totals:
    """Counts of a whole session, over all its segments."""

    links: tuple[LinkTotals, ...] = ()
    unpaired: int = 0
    """Skin frames without a wrench."""
    skin: SkinCondition = field(default_factory=SkinCondition)
    """Condition of the skin; without pokes in sessions that do not tell it."""
    pose_delays: PoseDelays | None = None
    """Delays of the tool's poses; `None` without a tool."""

    def plus(
        self, health: Sequence[LinkHealth], unpaired: int, skin: SkinCondition, pose_delays: PoseDelays | None = None
    ) -> Totals:
        """Add the counts of one more segment."""
        links = {link.link: link for link in self.links}
        for new in health:
            old = links.get(new.link, LinkTotals(new.link, "", 0))
            losses = Counter(old.losses) + Counter(new.losses)
            beside = merge_side_readings(old.beside, new.beside)
            counts = old.readings + new.readings, losses, beside
            frames = tuple(dict.fromkeys((*old.frames, *new.frames)))
            outages = old.outages.plus(new.outages)
            links[new.link] = LinkTotals(new.link, new.format or old.format, *counts, frames, outages)
        if self.pose_delays is not None:
            pose_delays = self.pose_delays if pose_delays is None else self.pose_delays.plus(pose_delays)
        return Totals(tuple(links.values()), self.unpaired + unpaired, self.skin.plus(skin), pose_delays)


@dataclass(frozen=True, slots=True)
class WallClock:
    """Time of day by a monotonic clock, which restarts with the machine."""

    monotonic_s: float
    unix_s: float

    def at(self, monotonic_s: float) -> float:
        """Convert to the time of day, seconds since 1970; NaN for earlier times, which another clock gave."""
        return self.unix_s + monotonic_s - self.monotonic_s if monotonic_s >= self.monotonic_s else math.nan


@dataclass(frozen=True, slots=True)
class SegmentHeader:
    """First event of a segment: its description."""

    number: int
    host_ns: int
    links: tuple[LinkSpec, ...]
    format: int
    digest: str | None
    """Of the scene's folder; `None` in old formats."""
    continues: bool
    """The segment before was full; otherwise the session was opened here to go on."""
    clock: WallClock | None = None
    """Of the machine that wrote it; `None` if it is not given."""


@dataclass(frozen=True, slots=True)
class SessionClosed:
    """The session was closed properly."""

    host_ns: int


Item: TypeAlias = Chunk | LinkEvent | TimedAction | SessionClosed
Result: TypeAlias = DetectorResult | Totals
SessionEvent: TypeAlias = SegmentHeader | LinkEvent | TimedAction | SessionClosed


def event_to_json(event: LinkEvent | TimedAction | SessionClosed) -> dict[str, Any]:
    """Convert an event to a JSON object."""
    if isinstance(event, LinkEvent):
        body = {"type": "link", "link": event.link, "state": event.state.value, "text": event.text}
        body |= {key: value for key, value in (("dropped", event.dropped), ("tried", event.tried)) if value}
    elif isinstance(event, SessionClosed):
        body = {"type": "end"}
    else:
        body = {"type": "action", **action_to_json(event.action)}
    return {"host_ns": event.host_ns, **body}


def result_to_json(result: Result) -> dict[str, Any]:
    """Convert a result to a JSON object."""
    if isinstance(result, Totals):
        counts = {
            link.link: {
                "format": link.format,
                "readings": link.readings,
                "lost": {loss.name: count for loss, count in link.losses.items() if count},
                **({"beside": {name: to_json(found) for name, found in link.beside.items()}} if link.beside else {}),
                **({"frames": list(link.frames)} if link.frames else {}),
                **({"outages": to_json(link.outages)} if link.outages.count else {}),
            }
            for link in result.links
        }
        skin = {"skin": to_json(result.skin)} if result.skin.is_known else {}
        delays = {} if result.pose_delays is None else {"pose_delays": to_json(result.pose_delays)}
        return {"type": "totals", "links": counts, "unpaired": result.unpaired, **skin, **delays}
    dead = {} if result.dead is None else {"dead": {str(channel): why for channel, why in result.dead.items()}}
    return {"type": "taken", "outcomes": [_outcome_to_json(outcome) for outcome in result.outcomes], **dead}


def key_of(result: Result) -> str:
    """Name the poke of a result; a later result of the same key replaces an earlier one. Empty: it replaces none.

    A second verdict of the same poke and kind replaces the first. If a contact became a rejection, both are kept, because undo
    needs the first.
    """
    if isinstance(result, Totals):
        return TOTALS_KEY
    if result.dead is not None or len(result.outcomes) != 1:
        return ""
    (outcome,) = result.outcomes
    return f"{'contact' if isinstance(outcome, Contact) else 'rejection'} {outcome.poke}"


def read_document(data: bytes, path: Path) -> SessionEvent | Result:
    """Read an event or a result from JSON bytes of the file `path`.

    Raises InputError: it is of a newer version, or not one that skincal wrote.
    """
    try:
        document = parse_json(data)
    except ValueError as error:
        raise InputError(f"{path}: an event or result is no JSON ({error}); {DAMAGED_OR_FOREIGN}.") from None
    if not isinstance(document, dict):
        raise InputError(f"{path}: an event or result is {quoted(document)}; expected a table; {DAMAGED_OR_FOREIGN}.")
    found = cast("dict[str, Any]", document)
    kind = found.get("type")
    body = {"host_ns": 0, **found}
    body.pop("type", None)
    body.pop("n", None)  # it numbered them in older sessions
    try:
        return _from_body(kind, body, path)
    except PARSE_ERRORS as error:
        raise InputError(
            f"{path}: an event or result of kind {kind!r} does not fit ({error!r}); {DAMAGED_OR_FOREIGN}."
        ) from None


def _from_body(kind: object, body: dict[str, Any], path: Path) -> SessionEvent | Result:
    """Read the event or result of the type `kind`; raises one of `PARSE_ERRORS`, or InputError."""
    match kind:
        case "link":
            return from_json(LinkEvent, body)
        case "end":
            return from_json(SessionClosed, body)
        case "action":
            host_ns = from_json(SessionClosed, {"host_ns": body.pop("host_ns")}).host_ns
            return TimedAction(host_ns, action_from_json(body))
        case "segment":
            return _read_header(body, path)
        case "taken":
            dead = body.get("dead")
            return DetectorResult(
                outcomes=[_read_outcome(entry) for entry in body["outcomes"]],
                dead=None if dead is None else {int(channel): str(why) for channel, why in dead.items()},
            )
        case "totals":
            links = tuple(_read_totals(name, link) for name, link in body["links"].items())
            delays = from_json(PoseDelays, body["pose_delays"]) if "pose_delays" in body else None
            return Totals(links, body["unpaired"], from_json(SkinCondition, body.get("skin", {})), delays)
        case _:
            raise InputError(
                f"{path}: has an event or result {quoted(kind)}, which this version does not know; "
                "open it with a newer skincal."
            )


def _read_header(body: Mapping[str, Any], path: Path) -> SegmentHeader:
    if body["format"] > JOURNAL_FORMAT_VERSION:
        raise InputError(
            f"{path}: was written by skincal {body['skincal']}, a newer one; expected format {JOURNAL_FORMAT_VERSION} at most."
        )
    if len(body["links"]) > MAX_LINKS:
        raise InputError(
            f"{path}: has {len(body['links'])} links; expected at most {MAX_LINKS}, one for each stream; {DAMAGED_OR_FOREIGN}."
        )
    has_clock = "unix_ns" in body and "monotonic_ns" in body
    values = {name: body[name] for name in ("host_ns", "links", "format")}
    values |= {"number": body["segment"], "digest": body.get("scene_digest"), "continues": body.get("continues", False)}
    values["clock"] = {"monotonic_s": body["monotonic_ns"] / 1e9, "unix_s": body["unix_ns"] / 1e9} if has_clock else None
    header = from_json(SegmentHeader, values)
    # Programs that a session names are never run, whoever wrote it.
    links = tuple(replace(link, address=address_for_journal(link.address)) for link in header.links)
    return replace(header, links=links)


def link_to_json(link: LinkSpec) -> dict[str, Any]:
    """Convert a link's settings to a JSON object."""
    carries = [stream.value for stream in link.carries]
    return {"name": link.name, "address": address_for_journal(link.address), "carries": carries, "format": link.format}


def _outcome_to_json(outcome: Outcome) -> dict[str, Any]:
    document = {"is": "contact" if isinstance(outcome, Contact) else "rejection", **to_json(outcome)}
    if outcome.press is not None:
        document["doubt"] = {"poke": to_json(outcome.press), "after": to_json(outcome.tare_after)}
    return document


def _read_outcome(document: Mapping[str, Any]) -> Outcome:
    body = dict(document)
    kind, doubt = body.pop("is"), body.pop("doubt", None)
    outcome = _check_contact(from_json(Contact, body)) if kind == "contact" else from_json(Rejection, body)
    if doubt is None:
        return outcome
    press = from_json(FinishedPress, doubt["poke"])
    if press.thresholds is not None:
        with_thresholds(ContactSettings(), asdict(press.thresholds))  # refuses values that no rig has
    return replace(outcome, press=press, tare_after=None if doubt["after"] is None else from_json(Tare, doubt["after"]))


def _check_contact(contact: Contact) -> Contact:
    """Refuse a contact that no sensor measured: the solver takes these numbers as they are."""
    channels, responses = contact.channels.tolist(), contact.responses.tolist()
    # In plain numbers: ten times faster than in arrays, and a session may have ten thousand contacts.
    numbers = (*contact.force.tolist(), *contact.moment.tolist(), *responses, contact.start_s, contact.end_s)
    is_bounded = all(-MAX_MEASURED_VALUE <= number <= MAX_MEASURED_VALUE for number in numbers)  # false for NaN
    is_right = 0 < contact.poke < MAX_POKE_NUMBER and any(numbers[:3])
    is_right &= len(channels) == len(responses) > 0 and channels == sorted(set(channels)) and min(responses) > 0
    if contact.vectors is not None:
        readings = contact.vectors.ravel().tolist()
        is_right &= len(contact.vectors) == len(channels)
        is_right &= all(math.isnan(number) or abs(number) <= MAX_MEASURED_VALUE for number in readings)
    if not is_bounded or not is_right:
        raise ValueError(f"poke {quoted(contact.poke)} is none that was measured")
    return contact


def _read_totals(name: str, body: Mapping[str, Any]) -> LinkTotals:
    losses = {Loss[loss]: int(count) for loss, count in body["lost"].items()}
    beside = {key: from_json(SideReading, found) for key, found in body.get("beside", {}).items()}
    frames = tuple(map(str, body.get("frames", ())))
    outages = from_json(Outages, body["outages"]) if "outages" in body else Outages()
    return LinkTotals(name, str(body["format"]), int(body["readings"]), losses, beside, frames, outages)

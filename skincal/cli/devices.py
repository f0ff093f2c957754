"""`devices` and `watch`: what can be connected here, and what a link says, before there is a session."""

from __future__ import annotations

import queue
import time
from collections import Counter
from dataclasses import asdict
from enum import Enum
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skincal.cli.record import stopping
from skincal.cli.solve import Json
from skincal.cli.terminal import say
from skincal.model.errors import InputError, plural
from skincal.model.readings import SENSOR_STREAMS, Batch, Chunk, LinkEvent, LinkState, Stream

if TYPE_CHECKING:
    from skincal.streams.decoders.auto_detect import LinkDecoder
    from skincal.streams.links import ChunkQueue

LISTEN_TIME_PER_PORT_S = 3.0
"""s on each serial port: three baud rates."""
WATCH_LINE_PERIOD_S = 1.0
"""s between two lines of `watch`."""
WRENCH_VALUES = 6
STARTED_SCHEMES = ("robotiq", "bota", "leptrino", "tsf85", "paxini", "ndi")
"""Schemes of serial devices that are silent until they are started."""


class Carries(Enum):
    """What a link is taken to carry."""

    ANY = "any"
    WRENCH = "wrench"
    SKIN = "skin"
    JOINTS = "joints"
    TOOL = "tool"


def add_to(app: typer.Typer) -> None:
    """Add the commands of this module."""
    app.command(epilog="Example: skincal devices")(devices)
    app.command(epilog="Example: skincal watch netft://192.168.1.1")(watch)


class Watched:
    """Data of one watched link: readings, rate, losses and messages of its device."""

    def __init__(self, address: str, carries: tuple[Stream, ...]) -> None:
        from skincal.devices.family import AUTO_FORMAT
        from skincal.streams.decoders.auto_detect import LinkDecoder
        from skincal.streams.link_diagnosis import LinkMonitor
        from skincal.streams.links import format_of, make_link_decoder
        from skincal.words.link_words import link_verdict_words

        # Now: imported at the first line, what comes meanwhile would count for the second.
        self._verdict_words = link_verdict_words
        # Without the width of a skin everything fits: who names one stream hears of another in its place.
        named = carries if len(carries) == 1 else ()
        self._monitor = LinkMonitor(
            named, {Stream.WRENCH: WRENCH_VALUES}, lambda: LinkDecoder(format_of(address, AUTO_FORMAT), None, SENSOR_STREAMS)
        )
        self._make = lambda: make_link_decoder(address, format_of(address, AUTO_FORMAT), None, carries)
        self._decoder: LinkDecoder = self._make()
        self._began_s = time.monotonic()
        self.readings: Counter[Stream] = Counter()
        self.newest: dict[Stream, str] = {}
        self.states: set[LinkState] = set()
        """What became of it so far."""

    def feed(self, item: Chunk | LinkEvent) -> None:
        """Process readings or an event of the watched link."""
        if isinstance(item, LinkEvent):
            self._monitor.on_event(item)
            self.states.add(item.state)
            if item.state is LinkState.OPEN:
                self._decoder = self._make()
            return
        batches = [batch for _, batch in self._decoder.feed(item.data, item.host_ns)]
        if item.data:
            self._monitor.on_data(item.data, item.host_ns, batches)
        for batch in batches:
            self.readings[batch.stream] += len(batch.seq)
            self.newest[batch.stream] = _newest(batch)

    def figures(self) -> dict[str, Any]:
        """Return the verdict, format, rates since the last call, newest readings, losses and what the device says."""
        now_s = time.monotonic()
        passed_s, self._began_s = max(now_s - self._began_s, 1e-3), now_s
        rates = {stream.value: round(count / passed_s, 1) for stream, count in self.readings.items()}
        self.readings.clear()
        decoder = self._decoder.current
        return {
            "verdict": self._verdict_words(self._monitor.diagnose(time.monotonic_ns())),
            "format": decoder.name,
            "rates": rates,
            "newest": {stream.value: words for stream, words in self.newest.items()},
            "units": {stream.value: words for stream, words in decoder.units.items() if stream in self.newest},
            "losses": {loss.value: count for loss, count in decoder.counts.items() if count},
            "beside": {name: asdict(found) for name, found in decoder.side_readings.items()},
            "note": decoder.device_message,
        }


def _newest(batch: Batch) -> str:
    import numpy as np

    values = batch.values[-1]
    if batch.stream is Stream.WRENCH:
        flags = " beyond its range" if batch.saturated[-1] else " invalid" if batch.invalid[-1] else ""
        return f"F {_numbers(values[:3].tolist(), 2)} N, M {_numbers(values[3:].tolist(), 3)} N m{flags}"
    if batch.stream is Stream.JOINTS:
        return f"{_numbers(np.degrees(values).tolist(), 1)} deg"
    if batch.stream is Stream.TOOL and np.isfinite(values).all():
        place, axis = (values[3::4] * 1e3).tolist(), values[2::4].tolist()
        return f"at {_numbers(place, 1)} mm, z axis {_numbers(axis, 3)}"
    finite = values[np.isfinite(values)]
    return (
        f"{len(values)} values, {finite.min():g} to {finite.max():g}" if finite.size else f"{len(values)} values, none finite"
    )


def _numbers(values: list[float], digits: int) -> str:
    return " ".join(f"{value:.{digits}f}" for value in values)


def _words(figures: dict[str, Any]) -> str:
    from skincal.model.readings import SideReading
    from skincal.words.link_words import beside_words

    of = {name: f" ({words})" for name, words in figures["units"].items()}
    parts = [] if figures["verdict"] == "good" else [figures["verdict"]]
    parts += [f"{name} {figures['rates'].get(name, 0):g}/s: {now}{of.get(name, '')}" for name, now in figures["newest"].items()]
    parts += [f"lost {count}: {why}" for why, count in figures["losses"].items()]
    parts += [beside_words({name: SideReading(**found) for name, found in figures["beside"].items()})]
    parts += [figures["note"]] if figures["note"] else []
    return " | ".join(filter(None, parts))


def watch(
    link: Annotated[str, typer.Argument(help="Address, as for record: netft://HOST, yarp:/PORT, /dev/ttyUSB0, ...")],
    carries: Annotated[Carries, typer.Option(help="Stream of the link, if its readings do not tell.")] = Carries.ANY,
    seconds: Annotated[
        float | None, typer.Option(min=0.0, help="Stop after this time, in seconds; default: at Ctrl-C.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Show what a link sends, live: readings, rate, losses and messages of the device; a line each second."""
    import json

    from skincal.devices.registry import carried_streams
    from skincal.streams.links import ChunkQueue, LinkSpec, Reader, parse_address

    address = parse_address(link)
    streams = carried_streams(address.route.format) if carries is Carries.ANY else (Stream(carries.value),)
    items = ChunkQueue()
    watched, reader = Watched(link, streams), Reader(LinkSpec("link", link, streams), items)
    end_s = float("inf") if seconds is None else time.monotonic() + seconds
    reader.start()
    try:
        with stopping() as stop:
            due_s = time.monotonic() + min(WATCH_LINE_PERIOD_S, seconds or WATCH_LINE_PERIOD_S)
            while not stop.is_set() and time.monotonic() < end_s and (reader.running or not items.empty()):
                _feed_until(watched, items, due_s)
                due_s += WATCH_LINE_PERIOD_S
                figures = watched.figures()
                say(json.dumps(figures) if as_json else f"{figures['format'] or '?'}  {_words(figures)}")
    finally:
        reader.stop()
    if LinkState.FAILED in watched.states and LinkState.OPEN not in watched.states:
        raise InputError(f"{link} could not be opened, as said above; `skincal devices` lists what is here.")


def _feed_until(watched: Watched, items: ChunkQueue, due_s: float) -> None:
    """Process items until `due_s` of the monotonic clock, and report changes of the link."""
    while (left_s := due_s - time.monotonic()) > 0:
        try:
            item = items.get(timeout=left_s)
        except queue.Empty:
            return
        if isinstance(item, LinkEvent):
            say(item.state.value + (f": {item.text}" if item.text else ""), err=True)
        watched.feed(item)


def devices(as_json: Json = False) -> None:
    """List serial ports with their answers, trackers, ports of YARP, and topics of ROS 2, with the addresses to type."""
    import json
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor() as threads:
        # Listening takes seconds.
        listening = threads.submit(_ros_topics)
        searching = threads.submit(_trackers)
        found = [_on_port(name, description) for name, description in _ports()]
        names, trouble = _yarp_ports()
        topics, proposed, ros_trouble = listening.result()
        trackers = searching.result()
    if not found:
        say("No serial port was found; plug a device in.", err=True)
    found += [{"address": address, "what": what} for address, what in trackers]
    found += [{"address": f"yarp:{name}", "what": f"YARP port at {host}:{number}"} for name, (host, number) in names]
    found += [{"address": address, "what": what} for address, what in topics]
    if as_json:
        say(json.dumps({"devices": found, "yarp": trouble, "ros2": ros_trouble, "proposed": proposed}))
        return
    for each in found:
        say(f"{each['address']}  {each['what']}")
    say(trouble if trouble else plural(len(names), "YARP port"), err=True)
    say(ros_trouble if ros_trouble else plural(len(topics), "topic") + " of ROS 2", err=True)
    if proposed:
        say(f"Proposed: {' '.join(f'--{stream} {address}' for stream, address in proposed.items())}", err=True)
    say(
        "Look at one: skincal watch ADDRESS. Sensors by network: netft://HOST, rtde://HOST, robotiq://HOST, xela://HOST, "
        "inspire://HOST. Trackers: qtm://HOST, natnet://HOST, ndi://HOST."
    )


def _ports() -> list[tuple[str, str]]:
    from skincal.streams.transports.serial_port import list_serial_ports

    return list_serial_ports()


def _on_port(name: str, description: str) -> dict[str, str]:
    """Listen to a serial port without sending anything: the port may be another machine's console."""
    from skincal.devices.link import LinkError
    from skincal.streams.links import LinkSpec, open_link
    from skincal.streams.transports.baud_search import BaudSearchLink

    streams = SENSOR_STREAMS
    watched = Watched(name, streams)
    try:
        link = open_link(LinkSpec("link", name, streams))
    except LinkError as failure:
        return {"address": name, "what": f"{description}: {failure}"}
    came, end_s = 0, time.monotonic() + LISTEN_TIME_PER_PORT_S
    tried: tuple[int, ...] = ()
    try:
        while time.monotonic() < end_s:
            data = link.read(0.1)
            came += len(data)
            watched.feed(Chunk("link", time.monotonic_ns(), data))
            if isinstance(link, BaudSearchLink) and link.tried != tried:
                tried = link.tried
                watched.feed(LinkEvent("link", time.monotonic_ns(), LinkState.OPEN, tried=tried))
    except LinkError as failure:
        return {"address": name, "what": f"{description}: {failure}"}
    finally:
        link.close()
    figures = watched.figures()
    if figures["newest"] and isinstance(link, BaudSearchLink) and link.found:
        return {"address": f"{name}@{link.baud}", "what": f"{description}: {figures['format']}, {_words(figures)}"}
    if came:
        return {"address": name, "what": f"{description}: {figures['verdict']}"}
    started = ", ".join(f"{scheme}:{name}" for scheme in STARTED_SCHEMES)
    return {"address": name, "what": f"{description}: silent; one that must be started? {started}"}


def _trackers() -> list[tuple[str, str]]:
    """Return address and description of each optical tracker that answers."""
    from skincal.streams.tracker_search import find_trackers

    return find_trackers()


def _yarp_ports() -> tuple[list[tuple[str, tuple[str, int]]], str]:
    """Return the ports that the name server of this machine's YARP knows, or why there are none."""
    from skincal.devices.link import LinkError
    from skincal.streams.links import yarp_ports

    try:
        return yarp_ports(), ""
    except LinkError as failure:
        return [], str(failure)


def _ros_topics() -> tuple[list[tuple[str, str]], dict[str, str], str]:
    """Return address and description of each topic, the proposed address of each stream, and why there are none or more."""
    try:
        from skincal.streams.ros_topics import list_ros_topics, propose_topics

        found, left_out = list_ros_topics()
    except InputError as error:
        return [], {}, str(error)
    proposed = {stream.value: each.address for stream, each in propose_topics(found).items()}
    more = f"{plural(len(found), 'topic')} of ROS 2, and {left_out} more that are not listed" if left_out else ""
    return [(each.address, each.words) for each in found], proposed, more

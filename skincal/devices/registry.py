"""Registry of device families: finds the family of an address or of a format. Nothing is opened here.

A device's address is `SCHEME://HOST:PORT/PATH?key=value`, or `SCHEME:PORT` for a serial port that needs more than its name.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from types import MappingProxyType
from typing import Any
from urllib.parse import parse_qsl, urlsplit

from skincal.devices.decoding import FrameDecoder
from skincal.devices.family import DeviceAddress, Family, Form, Route
from skincal.devices.plain import RECORDED_RUN, RUN, split_command
from skincal.model.errors import InputError
from skincal.model.readings import SENSOR_STREAMS, Stream


@dataclass(frozen=True, slots=True)
class Entry:
    """Names of a family, known before its file is imported: only the files of a scene's devices are imported."""

    schemes: tuple[str, ...]
    """Words before the colon of an address."""
    formats: tuple[str, ...] = ()
    checksummed: tuple[str, ...] = ()
    """Formats whose checksum proves them: they are tried on bytes that no text has."""


FAMILIES: Mapping[str, Entry] = MappingProxyType(
    {
        "netft": Entry(("netft",), ("rdt",)),
        "yarp": Entry(("yarp",), ("yarp-port",)),
        "bota": Entry(("bota",), ("bota",), ("bota",)),
        "robotiq": Entry(("robotiq",), ("robotiq", "robotiq-text"), ("robotiq",)),
        "rtde": Entry(("rtde",), ("rtde",)),
        "xela": Entry(("xela",), ("xela",)),
        "ros2": Entry(("ros2",), ("ros2",)),
        "rosbridge": Entry(("rosbridge",), ("rosbridge",)),
        "papillarray": Entry(("papillarray",), ("papillarray",), ("papillarray",)),
        "justfloat": Entry(("justfloat",), ("justfloat",)),
        "flexitac": Entry(("flexitac",), ("flexitac",)),
        "anyskin": Entry(("anyskin",), ("anyskin",)),
        "leptrino": Entry(("leptrino",), ("leptrino",)),
        "tsf85": Entry(("tsf85",), ("tsf85",)),
        "paxini": Entry(("paxini",), ("paxini",)),
        "paxini_module": Entry(("paxini-module",), ("paxini-module",)),
        "inspire": Entry(("inspire",), ("inspire",)),
        "qtm": Entry(("qtm",), ("qtm",)),
        "natnet": Entry(("natnet",), ("natnet",)),
        "ndi": Entry(("ndi",), ("ndi",)),
        "datagrams": Entry(("udp",), ("datagrams",)),
        "plain": Entry(("socket", "lines", "targets", "run")),
    }
)
"""By the name of the file in `skincal/devices/`."""
DEVICE_FORMATS = tuple(name for entry in FAMILIES.values() for name in entry.formats)
"""Names of all formats of devices."""
CHECKSUMMED_FORMATS = tuple(name for entry in FAMILIES.values() for name in entry.checksummed)
OPTIONS_WITH_VALUE = ("send", "after", "channels", "of", "format", "endian")
"""Options that cannot be left empty; any other empty one is as if it were not there."""
_FILE_OF_SCHEME = {scheme: file for file, entry in FAMILIES.items() for scheme in entry.schemes}
_FILE_OF_FORMAT = {name: file for file, entry in FAMILIES.items() for name in entry.formats}


def load_family(file: str) -> Family:
    """Import a family's file."""
    module: Any = import_module(f"skincal.devices.{file}")
    family: Family = module.DEVICE_FAMILY
    return family


def find_decoder(format_name: str) -> type[FrameDecoder] | None:
    """Return the decoder of a device's format, or `None`."""
    file = _FILE_OF_FORMAT.get(format_name)
    return None if file is None else load_family(file).decoders[format_name]


def carried_streams(format_name: str) -> tuple[Stream, ...]:
    """List the streams that a device's format may have: poses of a tool for a tracker, else those that values show."""
    file = _FILE_OF_FORMAT.get(format_name)
    vectors = () if file is None else load_family(file).vectors
    return (Stream.TOOL,) if vectors and all(vector.carries == (Stream.TOOL,) for vector in vectors) else SENSOR_STREAMS


def parse_device(address: str) -> DeviceAddress | None:
    """Read a device's address; `None` if no scheme of a device begins it.

    Raises InputError: the scheme is known and the rest is not valid.
    """
    if address.startswith(RECORDED_RUN):
        raise InputError(
            f"{address}: was recorded from a command, and a session starts none; "
            f"type {RUN}{address.removeprefix(RECORDED_RUN)} if you know it, or another address."
        )
    scheme, colon, rest = address.partition(":")
    if not colon or scheme not in _FILE_OF_SCHEME:
        return None
    routes = [route for route in load_family(_FILE_OF_SCHEME[scheme]).routes if route.scheme == scheme]
    for route in routes:
        try:
            found = _read_form(address, route, rest)
        except ValueError:
            continue
        if found is None:
            continue
        unknown = [key for key in found.options if key not in route.options]
        if unknown:
            allowed = ", ".join((*route.options, *(["baud"] if route.form is Form.SERIAL else []))) or "none"
            raise InputError(f"{address}: unknown option {unknown[0]!r}. Allowed options: {allowed}.")
        empty = [key for key, value in found.options.items() if not value]
        needs_value = next((key for key in empty if key in OPTIONS_WITH_VALUE), "")
        if needs_value:
            raise InputError(f"{address}: option {needs_value!r} has no value; expected {needs_value}=VALUE.")
        found = replace(found, options={key: value for key, value in found.options.items() if value})
        if route.check(found):
            return found
    examples = " or ".join(route.usage for route in routes)
    raise InputError(f"{address} is not a valid {scheme} address. Example: {examples}.")


def split_baud(address: str) -> tuple[str, int]:
    """Split `PORT@BAUD`; 0 for an address without a number after its last `@`."""
    path, at, baud = address.rpartition("@")
    if at and baud.isascii() and baud.isdigit() and int(baud) > 0:
        return path, int(baud)
    return address, 0


def _read_baud(address: str, place: str, option: str) -> tuple[str, int]:
    """Return port and baud rate of `PORT@BAUD` or `PORT?baud=BAUD`; 0 if neither names one. Raises InputError."""
    port, baud = split_baud(place)
    if option and not (option.isascii() and option.isdigit() and int(option) > 0):
        raise InputError(f"{address}: baud is {option!r}; expected a whole number such as 115200.")
    if option and baud and int(option) != baud:
        raise InputError(f"{address}: names two baud rates, {baud} and {option}; keep one.")
    return port, int(option) if option else baud


def _read_form(address: str, route: Route, rest: str) -> DeviceAddress | None:
    """Read the rest of an address by the form of a route. `None` or ValueError: it has another form."""
    if route.form is Form.COMMAND:
        return DeviceAddress(address, route, path=rest) if split_command(rest) else None
    if not rest.startswith("//"):
        place, _, query = rest.partition("?")
        is_path = place.startswith("/") and len(place) > 1
        if not place or not (route.form is Form.SERIAL or (route.form is Form.PATH and is_path)):
            return None
        options = dict(parse_qsl(query, keep_blank_values=True))
        if route.form is not Form.SERIAL:
            return DeviceAddress(address, route, path=place, baud=route.baud, options=options)
        place, baud = _read_baud(address, place, options.pop("baud", ""))
        return DeviceAddress(address, route, path=place, baud=baud or (0 if route.bauds else route.baud), options=options)
    parts = urlsplit(address)
    host, options = parts.hostname or "", dict(parse_qsl(parts.query, keep_blank_values=True))
    host.encode("idna")  # raises ValueError for a name that no host can have
    port = route.port if parts.port is None else parts.port
    has_path = len(parts.path) > 1
    # A reader of the address could take a name before an @ for the host.
    if parts.username is not None:
        return None
    if route.form is Form.HOST_OR_PORT:
        if bool(host) == has_path or parts.port is not None:
            return None
        # /dev/ttyACM0, but COM7
        place = parts.path if parts.path.count("/") > 1 else parts.path.removeprefix("/")
        place, baud = _read_baud(address, place, options.get("baud", ""))
        if baud:
            options["baud"] = str(baud)
        return DeviceAddress(address, route, host, path=place, options=options)
    if route.form is Form.LISTEN:
        # The check names the way for an address with a host.
        return DeviceAddress(address, route, host, port, options=options) if port and not has_path else None
    if route.form not in (Form.HOST, Form.HOST_PATH) or not host or not port or has_path != (route.form is Form.HOST_PATH):
        return None
    return DeviceAddress(address, route, host, port, parts.path if has_path else "", options=options)

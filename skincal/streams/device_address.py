"""Addresses of devices that are spoken to, and what each says of its device: nothing is opened here.

`SCHEME://HOST:PORT/PATH?key=value`, or `SCHEME:PORT` for a serial port that needs more than its name. `run:COMMAND` is what a
command prints. It is the operator's own word alone: a session keeps it as `ran:COMMAND` (`label_of`), which is never opened,
since a stranger's session would else run what it names.
"""

from __future__ import annotations

import shlex
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from urllib.parse import SplitResult, parse_qsl, urlsplit

from skincal.model.errors import InputError
from skincal.streams.decoders.detect import AUTO


@dataclass(frozen=True, slots=True)
class Scheme:
    """How the addresses of one kind of device begin, and what follows."""

    usage: str
    """An example, for sentences."""
    port: int = 0
    """TCP or UDP port where the address names none; 0: it must name one."""
    format: str = AUTO
    """Name of the decoder of what a host sends, of `skincal.streams.decoders.detect.NAMES`."""
    baud: int = 0
    """Baud rate of the serial port of that kind; 0: there is none."""
    serial_format: str = ""
    options: tuple[str, ...] = ()
    """Names that may stand after `?`."""
    host: bool = True
    """Whether it has hosts."""
    from_start: bool = False
    """What comes can be read from the beginning of a connection alone: it has a page first, or no mark between messages."""


RUN, RAN = "run:", "ran:"
DRIVER_NUMBERS = ("mode", "submode", "baud")
DRIVER_OPTIONS = (*DRIVER_NUMBERS, "product", "serial")


SCHEMES: Mapping[str, Scheme] = MappingProxyType(
    {
        "netft": Scheme("netft://192.168.1.1", 49152, "rdt", options=("cpf", "cpt", "device", "page"), from_start=True),
        "yarp": Scheme(
            "yarp:/icub/right_arm/analog:o or yarp://SERVER:10000/icub/right_arm/analog:o", 10000, "yarp-port", from_start=True
        ),
        "bota": Scheme(
            "bota:/dev/ttyUSB0, bota://192.168.0.45 or bota:///dev/ttyACM0", 0, "bota", 460800, "bota", DRIVER_OPTIONS
        ),
        "robotiq": Scheme("robotiq:/dev/ttyUSB0 or robotiq://192.168.1.2", 63351, "robotiq-text", 19200, "robotiq"),
        "rtde": Scheme("rtde://192.168.1.2", 30004, "rtde", from_start=True),
        "xela": Scheme("xela://127.0.0.1:5000", 5000, "xela"),
        "papillarray": Scheme("papillarray:/dev/ttyACM0", baud=115200, serial_format="papillarray", host=False),
        "lines": Scheme("lines://127.0.0.1:7000"),
        "run": Scheme("run:./my_sensor --rate 100", host=False),
    }
)
"""By the word before the colon."""


@dataclass(frozen=True, slots=True)
class DeviceAddress:
    """The address of a device that was understood."""

    text: str
    scheme: str
    format: str
    host: str = ""
    """Empty: a serial port, or a server to be looked up."""
    port: int = 0
    path: str = ""
    """Of a serial port, or of the port of a YARP network, with its slash; the command of `run:`."""
    baud: int = 0
    options: Mapping[str, str] = field(default_factory=dict[str, str])


def parse_device(address: str) -> DeviceAddress | None:
    """Return what a device's address names; None where it begins as no device's does.

    Raises
    ------
    InputError
        It begins so, and goes on otherwise.
    """
    if address.startswith(RAN):
        raise InputError(
            f"{address}: was recorded from a command, and a session starts none; type {RUN}{address.removeprefix(RAN)} "
            "if you know it, or another address."
        )
    name, colon, rest = address.partition(":")
    scheme = SCHEMES.get(name)
    if scheme is None or not colon:
        return None
    try:
        found = _host_form(address, name, scheme) if rest.startswith("//") else _place_form(address, name, scheme, rest)
    except ValueError:
        found = None
    if found is None:
        raise InputError(f"{address} is no address of a {name} device; expected such as {scheme.usage}.")
    strange = [key for key in found.options if key not in scheme.options]
    if strange:
        known = ", ".join(scheme.options) or "none"
        raise InputError(f"{address}: nothing is known of {strange[0]}; after ? may stand {known}.")
    return found


def _host_form(address: str, name: str, scheme: Scheme) -> DeviceAddress | None:
    parts = urlsplit(address)
    if name == "bota":
        return _driver_form(address, parts)
    port = scheme.port if parts.port is None else parts.port
    wants_path = name == "yarp"
    if not scheme.host or not parts.hostname or not port or wants_path != (len(parts.path) > 1) or parts.username is not None:
        return None
    return DeviceAddress(address, name, scheme.format, parts.hostname, port, parts.path, 0, dict(parse_qsl(parts.query)))


def _driver_form(address: str, parts: SplitResult) -> DeviceAddress | None:
    """Return what is read by the maker's driver: a host, or a serial port behind the third slash."""
    host, path, options = parts.hostname or "", parts.path, dict(parse_qsl(parts.query))
    if bool(host) == (len(path) > 1) or parts.port is not None or parts.username is not None:
        return None
    if not all(options[key].isascii() and options[key].isdigit() for key in DRIVER_NUMBERS if key in options):
        return None
    port = path if path.count("/") > 1 else path.removeprefix("/")  # /dev/ttyACM0, but COM7
    return DeviceAddress(address, "bota-driver", "bota", host, path=port, options=options)


def _place_form(address: str, name: str, scheme: Scheme, rest: str) -> DeviceAddress | None:
    if name == "run":
        return DeviceAddress(address, name, scheme.format, path=rest) if split_command(rest) else None
    place, _, query = rest.partition("?")
    options = dict(parse_qsl(query))
    if name == "yarp":
        return DeviceAddress(address, name, scheme.format, path=place) if place.startswith("/") and len(place) > 1 else None
    if not place or not scheme.baud:
        return None
    return DeviceAddress(address, name, scheme.serial_format, path=place, baud=scheme.baud, options=options)


def split_command(command: str) -> list[str] | str:
    """Return what the system starts: the words of a command, on Windows its line; empty where it has none.

    Windows has no words, and there a quote may be part of a name. Raises ValueError: a quote has no end.
    """
    return command.strip() if sys.platform == "win32" else shlex.split(command)


def from_start(address: str) -> bool:
    """Return whether bytes of this address are of no use once some before them were dropped."""
    return address.partition(":")[0] in SCHEMES and SCHEMES[address.partition(":")[0]].from_start


def label_of(address: str) -> str:
    """Return an address as a session keeps it: a command is no longer one."""
    return RAN + address.removeprefix(RUN) if address.startswith(RUN) else address


def format_of(address: str, given: str) -> str:
    """Return the name of the decoder for a link: the given one, or the one that its address says where that is `auto`."""
    if given != AUTO:
        return given
    try:
        device = parse_device(address)
    except InputError:
        return given
    return given if device is None else device.format

"""Transports, one file each. `FILE_OF_TRANSPORT` lists them; a file is imported when a link needs it.

A file has `open_transport(opening)`, which returns an open `Link` or raises LinkError.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from types import MappingProxyType
from typing import Any

from skincal.devices.family import AUTO_FORMAT, DeviceAddress
from skincal.devices.link import Link
from skincal.model.readings import Stream

FILE_OF_TRANSPORT: Mapping[str, str] = MappingProxyType(
    {
        "serial": "serial_port",
        "tcp": "tcp",
        "udp": "udp",
        "websocket": "websocket",
        "dds": "dds",
        "command": "command",
        "file": "file_replay",
        "targets": "target_tips",
    }
)
"""File in `skincal/streams/transports/` by the name that a route gives."""


@dataclass(frozen=True, slots=True)
class Opening:
    """Request to open a transport: its address, and the streams wanted from it."""

    address: DeviceAddress
    carries: tuple[Stream, ...] = ()
    format: str = AUTO_FORMAT
    is_cancelled: Callable[[], bool] = lambda: False
    """Whether to give up; may be asked from any thread."""


def open_transport(opening: Opening) -> Link:
    """Open the transport of an address. Raises LinkError."""
    module: Any = import_module(f"skincal.streams.transports.{FILE_OF_TRANSPORT[opening.address.route.transport]}")
    link: Link = module.open_transport(opening)
    return link

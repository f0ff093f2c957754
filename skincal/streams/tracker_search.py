"""Search for optical trackers in the network: their programs answer a broadcast.

QTM listens on UDP 22226 for a packet of kind 7 with the port to answer to (big-endian). It answers with its name, a zero, and
its base port, whose neighbour speaks the protocol that `qtm://` reads. A NatNet server answers a connection that is broadcast
to its command port. Sources: the maker's protocol documentation of QTM; `skincal.devices.natnet`.
"""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import time

from skincal.devices.natnet import (
    CONNECT,
    MESSAGE_MAX_BYTES,
    SERVER_INFO,
    SERVER_NAME_BYTES,
    ServerInfo,
    message,
    split_message,
)

BROADCAST_ADDRESS = "255.255.255.255"
QTM_DISCOVERY_PORT, NATNET_COMMAND_PORT = 22226, 1510
QTM_DISCOVERY_KIND, QTM_ANSWER_KIND = 7, 1
QTM_USUAL_BASE_PORT = 22222
WAIT_FOR_TRACKERS_S = 0.6
"""s for the answers: computers of one room."""
TRACKER_NAME_MAX_CHARS = 80


def find_trackers(
    qtm_port: int = QTM_DISCOVERY_PORT, natnet_port: int = NATNET_COMMAND_PORT, wait_s: float = WAIT_FOR_TRACKERS_S
) -> list[tuple[str, str]]:
    """List address and description of each tracker that answers a broadcast; empty if no network takes one."""
    found: dict[str, str] = {}
    with contextlib.ExitStack() as stack:
        qtm, natnet = (stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(2))
        for each in (qtm, natnet):
            each.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            each.setblocking(False)
            each.bind(("", 0))
        answer_port = struct.pack(">H", qtm.getsockname()[1])
        with contextlib.suppress(OSError):
            qtm.sendto(struct.pack("<2I", 10, QTM_DISCOVERY_KIND) + answer_port, (BROADCAST_ADDRESS, qtm_port))
        with contextlib.suppress(OSError):
            natnet.sendto(message(CONNECT), (BROADCAST_ADDRESS, natnet_port))
        end_s = time.monotonic() + wait_s
        while (left_s := end_s - time.monotonic()) > 0:
            for ready in select.select([qtm, natnet], [], [], left_s)[0]:
                with contextlib.suppress(OSError):
                    data, (host, port) = ready.recvfrom(MESSAGE_MAX_BYTES)
                    tracker = _read_qtm(data, host) if ready is qtm else _read_natnet(data, host, port)
                    found |= {} if tracker is None else dict([tracker])
    return sorted(found.items())


def _read_qtm(data: bytes, host: str) -> tuple[str, str] | None:
    """Read an answer of QTM; `None` if it is none."""
    name, zero, rest = data[8:].partition(b"\0")
    if len(data) < 8 or struct.unpack_from("<2I", data)[1] != QTM_ANSWER_KIND or not zero or len(rest) < 2:
        return None
    (base_port,) = struct.unpack_from(">H", rest)
    port = "" if base_port == QTM_USUAL_BASE_PORT else f":{base_port + 1}"
    return f"qtm://{host}{port}", f"Qualisys QTM: {name.decode(errors='replace')[:TRACKER_NAME_MAX_CHARS]}"


def _read_natnet(data: bytes, host: str, port: int) -> tuple[str, str] | None:
    """Read an answer of a NatNet server; `None` if it is none."""
    found = split_message(data)
    server = None if found is None or found[0] != SERVER_INFO else ServerInfo.read(found[1])
    if found is None or server is None:
        return None
    name = found[1][:SERVER_NAME_BYTES].partition(b"\0")[0].decode(errors="replace")[:TRACKER_NAME_MAX_CHARS]
    way = "by unicast" if server.group is None else f"by multicast to {server.group[0]}"
    at = "" if port == NATNET_COMMAND_PORT else f":{port}"
    return f"natnet://{host}{at}", f"OptiTrack {name}, NatNet {'.'.join(map(str, server.version))}, {way}"

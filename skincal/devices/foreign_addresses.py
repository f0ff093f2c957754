"""Addresses that other programs use, and what to type in their place."""

from __future__ import annotations

import re

_HOST_PORT_RE = re.compile(r"(?!COM\d)(?:[A-Za-z0-9][A-Za-z0-9.-]+|\[[0-9A-Fa-f:]+\]):\d{1,5}", re.IGNORECASE)
_PORT_BAUD_RE = re.compile(r"(?P<port>/dev/\S+?|COM\d+)[:,](?P<baud>\d{3,8})", re.IGNORECASE)
_TCP_RE = re.compile(r"(?:tcp|telnet|tcpclient|tcp-client):(?://)?(?P<rest>[^/?]+)/?", re.IGNORECASE)
_PROGRAM_OF_SCHEME = {
    "osc": ("OSC", "osc_lines.py"),
    "mqtt": ("MQTT", "mqtt_lines.py"),
    "mqtts": ("MQTT", "mqtt_lines.py"),
    "lsl": ("Lab Streaming Layer", "lsl_lines.py"),
    "ws": ("websockets", "ws_lines.py"),
    "wss": ("websockets", "ws_lines.py"),
}
"""Name of a protocol, and of the manual's program that prints its readings as lines, by scheme."""


def foreign_advice(address: str) -> str:
    """Advise on an address of another program; empty if it is not known."""
    if found := _PORT_BAUD_RE.fullmatch(address):
        return f"the baud rate of a serial port follows an @: type {found['port']}@{found['baud']}."
    if found := _TCP_RE.fullmatch(address):
        rest = (
            found["rest"] if ":" in found["rest"] else f"127.0.0.1:{found['rest']}" if found["rest"].isdigit() else "HOST:PORT"
        )
        return f"a TCP server is opened by its host and port: type socket://{rest}."
    scheme = address.partition(":")[0].lower() if ":" in address else ""
    if scheme not in _PROGRAM_OF_SCHEME:
        is_server = _HOST_PORT_RE.fullmatch(address)
        return f"for a TCP server type socket://{address}; for datagrams that arrive here, udp://:PORT." if is_server else ""
    name, program = _PROGRAM_OF_SCHEME[scheme]
    servers = " A rosbridge server is rosbridge://HOST:PORT/TOPIC, XELA's xela://HOST:PORT." if program == "ws_lines.py" else ""
    return (
        f"{name} is read by a program of ten lines that prints each reading: save {program} from docs/devices.md "
        f'("Other networks"), set its address and type "run:python3 {program}".{servers}'
    )

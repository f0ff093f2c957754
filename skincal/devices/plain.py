"""Sources without a protocol of their own: a TCP server or a program that sends lines, SKT/1, SKB/1 or a sensor's raw bytes.

`run:COMMAND` reads the output of a program. Only the operator can type it. A session keeps it as `ran:COMMAND`, which is never
opened, because a stranger's session would otherwise run the program that it names. `targets:/tip` is the tip of the robot that
`--targets` asks for pokes, as it reports it.
"""

from __future__ import annotations

import shlex
import sys
from dataclasses import replace

from skincal.devices.family import Command, DeviceAddress, Family, Form, Handshake, Questions, Route
from skincal.model.errors import InputError

RUN, RECORDED_RUN = "run:", "ran:"
REQUEST_MAX_CHARS = 100
REQUEST_AGAIN_AFTER_S = 1.0
"""s of silence after which a request is sent again: it may be lost, or the server started again."""


def split_command(command: str) -> list[str] | str:
    """Return the words of a command, on Windows its line; empty if there are none.

    Windows passes a line, and there a quote may be part of a name. Raises ValueError: a quote has no end.
    """
    return command.strip() if sys.platform == "win32" else shlex.split(command)


def address_for_journal(address: str) -> str:
    """Change an address for storage in a session, so that opening the session cannot run its command."""
    return RECORDED_RUN + address.removeprefix(RUN) if address.startswith(RUN) else address


def _with_command(address: DeviceAddress, questions: Questions) -> DeviceAddress:
    del questions
    return replace(address, command=Command(split_command(address.path), "the command"))


class RequestHandshake(Handshake):
    """Sends a request first, and again after silence; after each line, too, if the server answers a request by one line."""

    silence_s = REQUEST_AGAIN_AFTER_S

    def __init__(self, request: bytes, *, after_each_line: bool) -> None:
        self._request, self._after_each_line = request, after_each_line

    def opening(self) -> bytes:
        return self._request

    def on_data(self, data: bytes) -> bytes:
        return self._request if self._after_each_line and b"\n" in data else b""

    def on_silence(self) -> bytes:
        return self._request


def _check_request(address: DeviceAddress) -> bool:
    """Check the options. Raises InputError."""
    text, after = address.options.get("send"), address.options.get("after")
    is_line = text is None or (text.rstrip("\r\n").isprintable() and len(text) <= REQUEST_MAX_CHARS)
    if not is_line or (after is not None and (after != "line" or text is None)):
        raise InputError(
            f"{address.text}: expected send=TEXT, one line that the server waits for, and after=line if it answers each "
            "request by one line."
        )
    return True


def _with_request(address: DeviceAddress, questions: Questions) -> DeviceAddress:
    del questions
    text = address.options.get("send")
    if text is None:
        return address
    request = text.encode() if text.endswith(("\r", "\n")) else f"{text}\n".encode()
    return replace(address, handshake=RequestHandshake(request, after_each_line="after" in address.options))


def _tcp_route(usage: str) -> Route:
    return Route(
        usage=usage,
        form=Form.HOST,
        transport="tcp",
        options=("send", "after", "channels", "of"),
        check=_check_request,
        prepare=_with_request,
    )


DEVICE_FAMILY = Family(
    routes=(
        _tcp_route("socket://127.0.0.1:7000"),
        _tcp_route("lines://127.0.0.1:7000"),
        Route(usage="targets:/tip", form=Form.PATH, transport="targets", check=lambda address: address.path == "/tip"),
        Route(usage="run:./my_sensor --rate 100", form=Form.COMMAND, transport="command", prepare=_with_command),
    ),
)

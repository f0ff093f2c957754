"""Sources without a protocol of their own: a TCP server or a program that sends lines, SKT/1, SKB/1 or a sensor's raw bytes.

`run:COMMAND` reads the output of a program. Only the operator can type it. A session keeps it as `ran:COMMAND`, which is never
opened, because a stranger's session would otherwise run the program that it names. `targets:/tip` is the tip of the robot that
`--targets` asks for pokes, as it reports it.
"""

from __future__ import annotations

import shlex
import sys
from dataclasses import replace

from skincal.devices.family import Command, DeviceAddress, Family, Form, Questions, Route

RUN, RECORDED_RUN = "run:", "ran:"


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


FAMILY = Family(
    routes=(
        Route(usage="socket://127.0.0.1:7000", form=Form.HOST, transport="tcp"),
        Route(usage="lines://127.0.0.1:7000", form=Form.HOST, transport="tcp"),
        Route(usage="targets:/tip", form=Form.PATH, transport="targets", check=lambda address: address.path == "/tip"),
        Route(usage="run:./my_sensor --rate 100", form=Form.COMMAND, transport="command", prepare=_with_command),
    ),
)

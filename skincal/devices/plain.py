"""Sources without a protocol of their own: a TCP server or a program that sends lines, SKT/1, SKB/1 or a sensor's raw bytes.

`run:COMMAND` reads the output of a program. Only the operator can type it. A session keeps it as `ran:COMMAND`, which is never
opened, because a stranger's session would otherwise run the program that it names.
"""

from __future__ import annotations

import shlex
import sys
from dataclasses import replace

from skincal.devices.family import Command, DeviceAddress, Family, Form, Questions, Route, TableRow

RUN, RECORDED_RUN = "run:", "ran:"


def split_command(command: str) -> list[str] | str:
    """Return the words of a command, on Windows its line; empty if there are none.

    Windows passes a line, and there a quote may be part of a name. Raises ValueError: a quote has no end.
    """
    return command.strip() if sys.platform == "win32" else shlex.split(command)


def address_for_journal(address: str) -> str:
    """Return an address as a session keeps it: a command can no longer be run by it."""
    return RECORDED_RUN + address.removeprefix(RUN) if address.startswith(RUN) else address


def _with_command(address: DeviceAddress, questions: Questions) -> DeviceAddress:
    del questions
    return replace(address, command=Command(split_command(address.path), "the command"))


FAMILY = Family(
    routes=(
        Route(usage="socket://127.0.0.1:7000", form=Form.HOST, transport="tcp"),
        Route(usage="lines://127.0.0.1:7000", form=Form.HOST, transport="tcp"),
        Route(usage="run:./my_sensor --rate 100", form=Form.COMMAND, transport="command", prepare=_with_command),
    ),
    table=(
        TableRow(
            "anything that prints lines", "`lines://HOST:PORT`", "tests", "any", "with SKT/1: checksum, number, clock, status"
        ),
        TableRow("what a command prints", "`run:./my_sensor --rate 100`", "tests", "any", "the same; how it ended"),
    ),
    wiring=(
        (
            "boards of your own",
            "as text 84 taxels at 50 Hz are 17.9 kB/s: more than the 11.5 kB/s of 115200 baud; SKB/1 fits with 9 kB/s",
        ),
    ),
)

"""Serial ports, by pyserial.

pyserial is imported only here, and only when a port is opened. Its URLs run other code and write files (`spy://PORT?file=X`
empties X), and an address may come from a stranger's session, so a port is always opened by its plain name.
"""

from __future__ import annotations

import errno
import sys
from importlib import import_module
from typing import Any

from skincal.devices.family import AUTO_FORMAT
from skincal.devices.link import FailureKind, Link, LinkError
from skincal.streams.transports import Opening

DEFAULT_BAUD_RATE = 115200
READ_MAX_BYTES = 65536
"""Most bytes of one read: more than a second of any serial port."""
WRITE_TIMEOUT_S = 0.5
"""s. A command is a few bytes; a port that accepts none for so long is stuck."""


def open_transport(opening: Opening) -> Link:
    """Open the port. Without a baud rate and a format, the baud rate is searched, for a device among its rates."""
    address = opening.address
    if address.baud:
        return SerialLink(address.path, address.baud)
    if address.route.bauds:
        from skincal.streams.transports.baud_search import DeviceBaudLink

        rates = address.route.bauds
        return DeviceBaudLink(SerialLink(address.path, rates[0]), rates, address.route.format, opening.carries)
    if opening.format != AUTO_FORMAT:
        return SerialLink(address.path, DEFAULT_BAUD_RATE)
    # Imported now: it needs decoders.
    from skincal.streams.transports.baud_search import BaudSearchLink

    return BaudSearchLink(SerialLink(address.path, DEFAULT_BAUD_RATE), opening.carries)


def list_serial_ports() -> list[tuple[str, str]]:
    """List name and description of each serial port of this machine that has a device."""
    from serial.tools import list_ports

    return [(port.device, port.description or "") for port in list_ports.comports() if port.description != "n/a"]


class SerialLink:
    """A serial port or a pty."""

    tried: tuple[int, ...] = ()

    def __init__(self, port: str, baud: int) -> None:
        import serial

        self._name = port
        self._errors = _serial_errors()
        try:
            # Exclusive: on POSIX two programs could open one port otherwise, and each would get some of its bytes.
            # Not `serial_for_url`: it takes more for a URL than a port's name.
            self._port: Any = serial.Serial(port, baudrate=baud, timeout=0, write_timeout=WRITE_TIMEOUT_S, exclusive=True)
        # What pyserial raises for a rate that it cannot set.
        except ValueError as error:
            raise LinkError(
                FailureKind.ADDRESS, f"{port} does not open at {baud} baud ({error}); check the address and its @BAUD."
            ) from error
        except self._errors as error:
            raise _open_failure(port, error) from error
        self._ask_for_low_latency()

    def _ask_for_low_latency(self) -> None:
        """Set the latency of a USB adapter to 1 ms instead of 16; ptys and many drivers cannot, which is no error."""
        ask: Any = getattr(self._port, "set_low_latency_mode", None)
        if ask is None:
            return
        try:
            ask(True)
        except (ValueError, NotImplementedError, AttributeError, *self._errors):
            return

    def read(self, timeout_s: float) -> bytes:
        try:
            if self._port.timeout != timeout_s:
                # Each assignment sets up the whole port again.
                self._port.timeout = timeout_s
            # pyserial's `read(n)` waits until all n bytes are there or the time is over: so one is awaited, and what is
            # there with it is taken.
            first: bytes = self._port.read(1)
            waiting: int = self._port.in_waiting if first else 0
            return first + self._port.read(min(waiting, READ_MAX_BYTES)) if waiting else first
        except self._errors as error:
            raise LinkError(FailureKind.VANISHED, _vanished(self._name)) from error

    def write(self, data: bytes) -> None:
        try:
            self._port.write(data)
        except self._errors as error:
            raise LinkError(FailureKind.VANISHED, f"{self._name} takes no bytes: {error}.") from error

    def set_baud(self, baud: int) -> None:
        """Change the baud rate. A rate that the system refuses changes nothing."""
        try:
            self._port.baudrate = baud
        except ValueError:
            return
        except self._errors as error:
            raise LinkError(FailureKind.VANISHED, _vanished(self._name)) from error

    def close(self) -> None:
        try:
            self._port.close()
        except self._errors:
            return


def _serial_errors() -> tuple[type[Exception], ...]:
    """List the exceptions of pyserial: its own, OSError from a lost port, and termios.error on POSIX."""
    import serial

    try:
        termios: Any = import_module("termios")
    except ImportError:
        return serial.SerialException, OSError
    return serial.SerialException, OSError, termios.error


def _open_failure(port: str, error: Exception) -> LinkError:
    """Describe the system's error on a port in a sentence.

    pyserial keeps the error number on POSIX; on Windows only the name of the system's exception is left in its text, and
    there a port in use is a PermissionError.
    """
    number = getattr(error, "errno", None)
    text = str(error)
    windows = sys.platform == "win32"
    if number in (errno.EAGAIN, errno.EBUSY, errno.EWOULDBLOCK) or (windows and "PermissionError" in text):
        sentence = f"{port}: port is used by another program; close that program, or choose another port."
        return LinkError(FailureKind.IN_USE, sentence)
    if number in (errno.EACCES, errno.EPERM):
        return LinkError(FailureKind.DENIED, _denied(port))
    if number in (errno.ENOENT, errno.ENXIO, errno.ENODEV, errno.ENOTDIR, errno.EIO) or "FileNotFoundError" in text:
        return LinkError(FailureKind.ABSENT, f"There is no port {port}; plug the device in, or check the name.")
    if number == errno.EISDIR or "Could not configure port" in text:
        return LinkError(FailureKind.ADDRESS, f"{port} is not a serial port; expected a port such as /dev/ttyUSB0 or COM3.")
    return LinkError(FailureKind.OTHER, f"{port} cannot be opened: {text}.")


def _denied(port: str) -> str:
    if sys.platform.startswith("linux"):
        return (
            f"{port}: permission denied; add yourself to the group that owns it, on most systems dialout "
            "(sudo usermod -aG dialout $USER), and log in again."
        )
    return f"{port}: permission denied; the port belongs to another user."


def _vanished(port: str) -> str:
    return f"{port} was lost; plug the device in again, then it is read again."

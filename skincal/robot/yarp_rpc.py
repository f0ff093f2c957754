"""Client of a YARP port that answers questions (RPC)."""

from __future__ import annotations

import time
from collections.abc import Sequence

from skincal.devices.decoding import ProtocolError
from skincal.devices.family import DeviceAddress
from skincal.devices.link import FailureKind, LinkError
from skincal.devices.registry import parse_device
from skincal.devices.yarp import READER_HELLO, MessageSplitter, find_port, read_answer, write_question
from skincal.streams.opening import NetworkQuestions
from skincal.streams.transports.tcp import TcpLink


def parse_rpc_address(address: str) -> DeviceAddress:
    """Read the address of a YARP port. Raises LinkError: it is not one. Nothing is opened."""
    device = parse_device(address)
    if device is None or device.route.scheme != "yarp":
        usage = "yarp:/skinManager/rpc or yarp://SERVER:10000/skinManager/rpc"
        raise LinkError(FailureKind.ADDRESS, f"{address} is not a YARP port. Example: {usage}.")
    return device


class YarpRpcClient:
    """Asks a YARP port one question after another, in binary.

    Raises LinkError: the address is not a YARP port, or it does not answer within `timeout_s`.
    """

    def __init__(self, address: str, timeout_s: float) -> None:
        self._address, self._timeout_s, self._splitter = address, timeout_s, MessageSplitter()
        device = find_port(parse_rpc_address(address), NetworkQuestions())
        try:
            self._link = TcpLink(device.label, device.host, device.port)
        except LinkError as error:
            raise LinkError(error.kind, f"{error} {device.connect_hint}") from error
        try:
            self._link.write(READER_HELLO)
            self._read_messages()
        except BaseException:
            self.close()
            raise

    def ask(self, question: Sequence[str | int | float]) -> list[float | str]:
        """Return the values that the port answers. Raises LinkError; then nothing more can be asked."""
        self._link.write(write_question(question))
        try:
            return read_answer(self._read_messages()[0])
        except ProtocolError as error:
            raise LinkError(FailureKind.PROTOCOL_ERROR, f"{self._address}: its answer cannot be read: {error}.") from error

    def _read_messages(self) -> list[bytes]:
        """Read until a message comes, or the port's number at the beginning of a connection."""
        end_s = time.monotonic() + self._timeout_s
        is_new, messages = self._splitter.port is None, list[bytes]()
        while not messages and not (is_new and self._splitter.port is not None):
            left_s = end_s - time.monotonic()
            if left_s <= 0:
                raise LinkError(FailureKind.ABSENT, f"{self._address}: no answer within {self._timeout_s:g} s.")
            messages = [message for message in self._splitter.split(self._link.read(left_s)) if message is not None]
            if self._splitter.fault:
                raise LinkError(FailureKind.PROTOCOL_ERROR, f"{self._address}: {self._splitter.fault}.")
        return messages

    def close(self) -> None:
        self._link.close()

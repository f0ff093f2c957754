"""A simulated skinManager in a YARP network of its own, and a robot at the port for targets, as tests drive them."""

import socket
from contextlib import closing, contextmanager

from skincal.simulation.emulated_devices import NameTalk
from skincal.simulation.emulated_transports import TalkOutlet
from tests.skincal.meanwhile import meanwhile


@contextmanager
def robot(manager):
    """Serve an outlet as the skinManager of a YARP network; its address."""
    names = TalkOutlet(lambda: NameTalk({"/skinManager/rpc": manager.port}), "yarp://127.0.0.1:{}/skinManager/rpc")

    def serve(over):
        while not over.wait(0.001):
            names.poll()
            manager.poll()

    with closing(names), closing(manager), meanwhile(serve):
        yield names.address


class Peer:
    """A client as a test drives it."""

    def __init__(self, port):
        self.socket = socket.create_connection(("127.0.0.1", port), 10.0)
        self._file = self.socket.makefile("rb")

    def say(self, text):
        self.socket.sendall(text if isinstance(text, bytes) else f"{text}\n".encode())

    def line(self):
        """The next line; None where the other side hung up."""
        try:
            return self._file.readline().decode().rstrip("\n") or None
        except ConnectionError:
            return None

    def close(self):
        self._file.close()
        self.socket.close()

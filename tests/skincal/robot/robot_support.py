"""A simulated skinManager in a YARP network of its own, and a robot at the port for targets, as tests drive them."""

import socket
import threading
from contextlib import closing, contextmanager

from skincal.simulate.maker_outlets import TalkOutlet
from skincal.simulate.makers import NameTalk


@contextmanager
def robot(manager):
    """Serve an outlet as the skinManager of a YARP network; its address."""
    names = TalkOutlet(lambda: NameTalk({"/skinManager/rpc": manager.port}), "yarp://127.0.0.1:{}/skinManager/rpc")
    done = threading.Event()

    def serve():
        while not done.wait(0.001):
            names.poll()
            manager.poll()

    thread = threading.Thread(target=serve)
    with closing(names), closing(manager):
        thread.start()
        try:
            yield names.address
        finally:
            done.set()
            thread.join()


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

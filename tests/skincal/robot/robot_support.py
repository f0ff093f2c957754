"""A simulated skinManager in a YARP network of its own, for the tests of the command and of the window."""

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

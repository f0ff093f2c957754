"""Work in a thread beside a test: a device that sends, a server that answers."""

from __future__ import annotations

import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager

PATIENCE_S = 20.0
"""s. The work notices that the block is over within this, also on a busy machine."""


@contextmanager
def meanwhile(work: Callable[[threading.Event], object]) -> Generator[None]:
    """Run `work` in a thread for as long as the block; it is given the event that says that the block is over."""
    over = threading.Event()
    thread = threading.Thread(target=work, args=(over,))
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join(PATIENCE_S)
        assert not thread.is_alive()

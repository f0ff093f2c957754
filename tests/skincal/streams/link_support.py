"""Readers of links as tests drive them."""

import queue
import time
from contextlib import contextmanager

from skincal.model.readings import Chunk, LinkEvent, Stream
from skincal.streams.links import LinkSpec, Reader

PATIENCE_S = 5.0
WRENCH = (Stream.WRENCH,)


def spec(address, carries=WRENCH, name="link"):
    return LinkSpec(name, str(address), carries)


@contextmanager
def reading(address, carries=WRENCH):
    """A running reader and its queue; stopped at the end, and quickly."""
    items = queue.SimpleQueue()
    reader = Reader(spec(address, carries), items)
    reader.start()
    try:
        yield items
    finally:
        reader.stop()
        assert not reader.running


def next_event(items, state, patience_s=PATIENCE_S):
    """The next event, which must be of this state; chunks before it are passed over."""
    end = time.monotonic() + patience_s
    while True:
        item = items.get(timeout=max(end - time.monotonic(), 0.001))
        if isinstance(item, LinkEvent):
            assert item.state is state, item
            return item


def next_data(items, count, patience_s=PATIENCE_S):
    """The next bytes, as many as asked for."""
    data = b""
    end = time.monotonic() + patience_s
    while len(data) < count:
        item = items.get(timeout=max(end - time.monotonic(), 0.001))
        assert isinstance(item, Chunk), item
        data += item.data
    return data

"""The writer of MCAP files makes the bytes of the library's, and puts many messages in at once."""

from io import BytesIO

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import Writer

from skincal.journal import mcap_writer
from skincal.journal.mcap_writer import McapWriter

TIMES = st.integers(0, 2**63 - 1)
SINGLE = st.tuples(st.integers(1, 2), TIMES, st.binary(max_size=40), st.integers(0, 2**32 - 1))
MANY = st.tuples(st.just(3), st.lists(TIMES, min_size=1, max_size=4), st.binary(min_size=8, max_size=8))
STEPS = st.lists(st.one_of(SINGLE, MANY, st.just("flush")), max_size=12)


def begin_library(file):
    library = Writer(file, chunk_size=1 << 20)
    library.start("ros2", "skincal")
    return library


def fill(writer, steps, add, add_many):
    """Write the same schemas, channels, texts and messages."""
    writer.add_metadata("about", {"text": "wörd", "": "1"})
    schemas = [writer.register_schema(name, "ros2msg", b"float64 x") for name in ("one", "two")]
    for topic in ("/raw/skin", "/events", "/wrench"):
        writer.register_channel(topic, "cdr", schemas[0])
    for step in steps:
        if step == "flush":
            writer.flush()
        elif step[0] == 3:
            add_many(*step)
        else:
            add(*step)
    writer.finish()


@given(STEPS)
def test_the_files_are_equal_to_the_librarys(steps):
    known, made = BytesIO(), BytesIO()
    library, writer = begin_library(known), McapWriter(made, "ros2", "skincal")

    def add(channel, at, data, sequence=0):
        library.add_message(channel, at, data, at, sequence)

    fill(library, steps, add, lambda channel, times, data: [add(channel, at, data) for at in times])
    fill(
        writer,
        steps,
        writer.add_message,
        lambda channel, times, data: writer.add_messages(
            channel, np.array(times), np.tile(np.frombuffer(data, np.uint8), (len(times), 1))
        ),
    )
    assert made.getvalue() == known.getvalue()


@pytest.mark.parametrize("many", [False, True])
def test_a_long_chunk_ends_by_itself(monkeypatch, many):
    monkeypatch.setattr(mcap_writer, "CHUNK_MAX_BYTES", 100)
    file = BytesIO()
    writer = McapWriter(file, "ros2", "skincal")
    channel = writer.register_channel("/wrench", "cdr", 0)
    before = len(file.getvalue())
    if many:
        writer.add_messages(channel, np.arange(2), np.zeros((2, 50), np.uint8))
    else:
        writer.add_message(channel, 0, bytes(90))
    assert len(file.getvalue()) > before

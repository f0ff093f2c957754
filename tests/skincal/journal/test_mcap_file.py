import io

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from skincal.journal.mcap_file import McapWriter

START_NS = 1_700_000_000_000_000_000
SCHEMA = "skincal_msgs/msg/Chunk", "ros2msg", b"uint64 host_ns\n"
RNG_SEED = 3


def by_library(blocks) -> bytes:
    file = io.BytesIO()
    writer = Writer(file, chunk_size=1 << 30)
    writer.start(profile="ros2", library="skincal test")
    writer.add_metadata("skincal", {"a": "1", "b": "two"})
    schema = writer.register_schema(*SCHEMA)
    channels = [writer.register_channel(topic, "cdr", schema) for topic in ("/raw", "/wrench")]
    for block in blocks:
        for channel, times, data, sequence in block:
            for time, row in zip(times, data, strict=True):
                writer.add_message(channels[channel], time, bytes(row), time, sequence=sequence)
        writer.flush()
    writer.finish()
    return file.getvalue()


def by_ours(blocks) -> bytes:
    file = io.BytesIO()
    writer = McapWriter(file, profile="ros2", library="skincal test")
    writer.add_metadata("skincal", {"a": "1", "b": "two"})
    schema = writer.register_schema(*SCHEMA)
    channels = [writer.register_channel(topic, "cdr", schema) for topic in ("/raw", "/wrench")]
    for block in blocks:
        for channel, times, data, sequence in block:
            if len(times) > 1:
                writer.add_messages(channels[channel], np.array(times), np.array(data))
            else:
                writer.add_message(channels[channel], times[0], bytes(data[0]), sequence)
        writer.flush()
    writer.finish()
    return file.getvalue()


def some_blocks(count: int):
    rng = np.random.default_rng(RNG_SEED)
    for index in range(count):
        late = START_NS + 1_000_000 * index - 500_000 * (index % 3)
        several = [late + 1000 * k for k in (2, 0, 1, 7)]
        alone = (0, [late], rng.integers(0, 256, (1, 30 + index), dtype=np.uint8), 5 + index)
        wrenches = (1, several, rng.integers(0, 256, (4, 76), dtype=np.uint8), 0)
        yield [[alone, wrenches], [wrenches, alone], [wrenches], []][index % 4]


@pytest.mark.parametrize("count", [0, 1, 2, 9])
def test_a_file_is_to_the_byte_what_the_library_writes(count):
    ours = by_ours(some_blocks(count))
    assert ours == by_library(some_blocks(count))
    messages = sum(len(times) for block in some_blocks(count) for _, times, _, _ in block)
    assert sum(1 for _ in make_reader(io.BytesIO(ours), validate_crcs=True).iter_messages()) == messages


def test_nothing_lies_in_the_file_before_a_flush():
    file = io.BytesIO()
    writer = McapWriter(file, profile="ros2", library="skincal test")
    channel = writer.register_channel("/raw", "cdr", writer.register_schema(*SCHEMA))
    begun = file.tell()
    writer.add_message(channel, START_NS, b"abc")
    assert file.tell() == begun
    writer.flush()
    written = file.tell()
    assert written > begun
    writer.flush()
    assert file.tell() == written

"""How bytes are cut never matters: one proof for the decoders of all formats."""

from collections import Counter
from collections.abc import Callable, Iterable
from itertools import pairwise

import numpy as np

from skincal.devices.decoding import FrameDecoder
from skincal.model.readings import Batch, Stream


def readings(batches: Iterable[Batch]) -> dict[Stream, list[tuple[bytes, ...]]]:
    """Number, device time, values and flags of each reading to the last bit, in the order of each stream."""
    found: dict[Stream, list[tuple[bytes, ...]]] = {stream: [] for stream in Stream}
    for batch in batches:
        columns = (batch.seq, batch.device_s, batch.values, batch.saturated, batch.invalid)
        found[batch.stream] += zip(*([np.asarray(row).tobytes() for row in column] for column in columns), strict=True)
    return found


def fed(decoder: FrameDecoder, data: bytes, cuts: Iterable[int] = ()) -> list[Batch]:
    """Feed bytes that are cut at some places."""
    return [batch for begin, end in pairwise([0, *sorted(cuts), len(data)]) for batch in decoder.feed(data[begin:end])]


def assert_cuts_never_matter(make: Callable[[], FrameDecoder], data: bytes, cuts: Iterable[int] = ()) -> list[Batch]:
    """Expect the same readings and counts from whole bytes, from cut ones and byte by byte. Return the batches of the whole."""
    whole = make()
    batches = fed(whole, data)
    expected = readings(batches)
    for places in (cuts, range(1, len(data))):
        decoder = make()
        assert readings(fed(decoder, data, places)) == expected
        assert Counter(decoder.counts) == Counter(whole.counts)
        assert decoder.valid_records == whole.valid_records
    return batches

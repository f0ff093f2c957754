"""Every format gives the same readings and the same counts, however its bytes are cut."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skincal.devices.registry import DEVICE_FORMATS
from skincal.model.readings import Stream
from skincal.streams.decoders.auto_detect import NAMES, make_decoder
from tests.skincal.streams.cut_bytes import assert_cuts_never_matter
from tests.skincal.streams.maker_records import VECTORS, record_streams

ALL = (Stream.WRENCH, Stream.SKIN, Stream.JOINTS)
WORDS = "1.5 -2.25 30.0 0.125 -0.5 0.0625"
YARP_LINES = st.one_of(
    st.just(f"4 2.5 {WORDS}\n".encode()),
    st.just(f"5 2.6 () () () () () ((({WORDS}) 1)) () () () ()\n".encode()),
    st.just(b"6 2.7 \n"),
    st.just(b"6 2.7 1 2 3\n"),
    st.just(b"7 2.7 (1 2\n"),
    st.binary(max_size=12),
)
DELIMITED = st.binary(max_size=300).map(lambda raw: raw.replace(b"\x07", b"\n1,2,3\n").replace(b"\x08", b"\n\n"))


@st.composite
def spoiled(draw, vector):
    """Records of a device with garbage in and between them."""
    stream = bytearray(vector.data + vector.repeat * 5)
    for _ in range(draw(st.integers(0, 4))):
        at = draw(st.integers(0, len(stream)))
        stream[at : at + draw(st.integers(0, 3))] = draw(st.binary(max_size=12))
    return bytes(stream)


STREAMS = {
    "skb": (5, ALL, record_streams("skb").map(b"".join)),
    "skt": (5, ALL, record_streams("skt").map(b"".join)),
    "csv": (3, (Stream.SKIN,), DELIMITED),
    **{name: (None, (Stream.WRENCH,), st.lists(YARP_LINES, max_size=8).map(b"".join)) for name in NAMES if "yarp" in name},
    **{name: (vector.channels, vector.carries, spoiled(vector)) for name, vector in VECTORS.items()},
}
"""Of each format: channels and streams of its link, and bytes of it with some that are no reading."""


def test_every_format_of_a_device_is_tried():
    assert set(STREAMS) >= {"skb", "skt", "csv", *DEVICE_FORMATS}


@pytest.mark.parametrize("name", STREAMS)
@settings(max_examples=20, deadline=None)
@given(data=st.data())
def test_how_the_bytes_are_cut_never_matters(name, data):
    channels, carries, streams = STREAMS[name]
    raw = data.draw(streams) + data.draw(st.binary(max_size=20))
    cuts = data.draw(st.lists(st.integers(0, len(raw)), max_size=12))
    assert_cuts_never_matter(lambda: make_decoder(name, channels, carries), raw, cuts)

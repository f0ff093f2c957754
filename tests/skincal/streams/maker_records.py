"""Records of makers' devices, written from the formats' descriptions; the published ones are the vectors of the families."""

import binascii
import struct

import numpy as np
from cobs import cobs as reference_cobs
from hypothesis import strategies as st

from skincal.devices.decoding import pack
from skincal.devices.netft import PAGE, RECORDS
from skincal.devices.netft_page import given_page
from skincal.devices.registry import FAMILIES, load_family
from tests.skincal.poke_script import skt_line

VECTORS = {vector.format: vector for file in FAMILIES for vector in reversed(load_family(file).vectors)}
"""The first vector of each format."""
WRENCH = (1.5, -2.25, 30.0, 0.125, -0.5, 0.0625)
RDT_PAGE = (
    b"<?xml version='1.0'?><netft><prodname>Ethernet Axia80</prodname><cfgcpf>1000000</cfgcpf><cfgcpt>1000000</cfgcpt>"
    b"<scfgfu>N</scfgfu><scfgtu>Nm</scfgtu></netft>"
)
YARP_NUMBER, YARP_HEAD = bytes.fromhex("5941062900005250"), bytes.fromhex("59410a0000005250")
YARP_VECTOR = VECTORS["yarp-port"].repeat
SKB_TAXELS = bytes.fromhex("020102110420300502C902C7040609C803F32E00")
SKT_TAXELS = b"T,17,340000,201,199,2310,200*E4DB\n"


def skb(kind, seq, t_us, payload, source=0):
    body = struct.pack("<BBHI", kind, source, seq & 0xFFFF, t_us & 0xFFFFFFFF) + payload
    return reference_cobs.encode(body + binascii.crc_hqx(body, 0xFFFF).to_bytes(2, "little")) + b"\x00"


def skb_skin(seq, t_us, values, dtype="<u2"):
    return skb({"<u2": 1, "u1": 3, "<f4": 4}[dtype], seq, t_us, np.array(values, dtype).tobytes())


def skb_wrench(seq, t_us, wrench, status=0):
    return skb(2, seq, t_us, struct.pack("<6fI", *wrench, status))


@st.composite
def record_streams(draw, name):
    """Records of skins of 5 taxels and of wrenches, of the format `skb` or `skt`."""
    records = []
    for seq in range(draw(st.integers(1, 8))):
        if draw(st.booleans()):
            values = draw(st.lists(st.integers(0, 65535), min_size=5, max_size=5))
            text = f"T,{seq},{1000 + seq},{','.join(map(str, values))}"
            records.append(skb_skin(seq, 1000 + seq, values) if name == "skb" else skt_line(text))
        else:
            wrench = draw(st.lists(st.floats(-1e3, 1e3, width=32), min_size=6, max_size=6))
            text = f"F,{seq},{1000 + seq},{','.join(map(repr, wrench))},0"
            records.append(skb_wrench(seq, 1000 + seq, wrench) if name == "skb" else skt_line(text))
    return records


def rdt_packets(records, page=None):
    return pack(PAGE, given_page(1e6, 1e6, "Net F/T") if page is None else page) + b"".join(pack(RECORDS, r) for r in records)


def rdt_record(number, counts=(1, 2, 3, 4, 5, 6), status=0):
    return struct.pack("!III6i", number, number * 7 % 2**32, status, *counts)


def yarp_message(payload, seq=None, stamp=0.0):
    """A message, with an envelope if it has a number."""
    if seq is None:
        command = bytes(4) + b"~D\x00\x01"
    else:
        text = f"D {seq} {stamp:.15g}".encode() + b"\x00"
        command = struct.pack("<i", len(text)) + b"~\x00\x00\x01" + text
    blocks = struct.pack("<2B8s3i", 2, 1, b"\xff" * 8, len(command), len(payload), 0)
    return YARP_HEAD + blocks + command + payload


def yarp_doubles(values):
    return struct.pack("<ii", 266, len(values)) + np.asarray(values, "<f8").tobytes()


def yarp_list(items):
    return struct.pack("<ii", 256, len(items)) + b"".join(items)


def yarp_measure(values, stamp):
    return yarp_list([yarp_doubles(values), struct.pack("<id", 10, stamp)])


def yarp_measures(groups, wrench=None, skin=(), stamp=1795354062.0748205):
    """`measures:o` with so many groups."""
    lists = [yarp_list([]) for _ in range(groups)]
    lists[0] = yarp_list([yarp_measure([275.0] * 3, stamp)])
    if wrench is not None:
        lists[5] = yarp_list([yarp_measure(wrench, stamp)])
    lists[8] = yarp_list([yarp_measure(patch, stamp) for patch in skin])
    return yarp_list(lists)

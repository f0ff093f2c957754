"""Records of makers' devices, written from the formats' descriptions, and bytes that real ports sent; shared by their tests."""

import struct

import numpy as np

from skincal.devices.decoding import pack
from skincal.devices.netft import PAGE, RECORDS, given_page

WRENCH = (1.5, -2.25, 30.0, 0.125, -0.5, 0.0625)

# ATI RDT: the record of netft-cpp's tests (saturated), and one with a million counts for each N and N m.
RDT_SATURATED = bytes.fromhex("FFFFFFFF8000000080020000FFFFFFFF00000002FFFFFFFD00000004FFFFFFFB00000006")
RDT_RECORD = bytes.fromhex("00000001000012670000000000BC4B20FFA97B9005D8E3200001E078FFED2BB000001388")
HEX_RECORD = bytes.fromhex("0000000100000001000000000001E208FFFF2284000EF8080000300CFFFE1DF8000001F4")
RDT_WRENCH = (12.34, -5.67, 98.1, 0.123, -1.234, 0.005)
RDT_PAGE = (
    b"<?xml version='1.0'?><netft><prodname>Ethernet Axia80</prodname><cfgcpf>1000000</cfgcpf><cfgcpt>1000000</cfgcpt>"
    b"<scfgfu>N</scfgfu><scfgtu>Nm</scfgtu></netft>"
)


def rdt_packets(records, page=None):
    return pack(PAGE, given_page(1e6, 1e6, "Net F/T") if page is None else page) + b"".join(pack(RECORDS, r) for r in records)


def rdt_record(number, counts=(1, 2, 3, 4, 5, 6), status=0):
    return struct.pack("!III6i", number, number * 7 % 2**32, status, *counts)


# Bota gen0: status 0 and status 2 (beyond the range).
BOTA = bytes.fromhex("AA00000000C03F000010C00000F0410000003E000000BF0000803D40E2010000001242E3F6")
BOTA_OVER = bytes.fromhex("AA02000000C03F000010C00000F0410000003E000000BF0000803D40E20100000012425955")
# Robotiq's stream.
ROBOTIQ = bytes.fromhex("204ED204C9FD52267B002EFB05007784")
ROBOTIQ_TEXT = b"(1.50 , -2.25 , 30.00 , 0.1250 , -0.5000 , 0.0625)"
# RTDE: recipe 1, 12.5 s, q, wrench; the answers of the handshake before it.
RTDE_DATA = bytes.fromhex(
    "006c55014029000000000000" "3fe0000000000000bff00000000000003ff8000000000000"
    "00000000000000003fd0000000000000bfe8000000000000"
    "3ff8000000000000c002000000000000403e000000000000"
    "3fc0000000000000bfe00000000000003fb0000000000000"
)  # fmt: skip
RTDE_Q = (0.5, -1.0, 1.5, 0.0, 0.25, -0.75)
RTDE_ANSWERS = b"\x00\x04V\x01" + b"\x00\x1cO\x01DOUBLE,VECTOR6D,VECTOR6D" + b"\x00\x04S\x01"
# PapillArray: number 42, 987654321 us, one sensor with two pillars.
PAPILLARRAY = bytes.fromhex(
    "55667788" "02 01000d00 03001900 04005700" "2a000000 b168de3a00000000"
    "01000400 0200 0600 2000"
    "0200 0000803f 00000040 00004040 0000003f 0000803e 0000003e"
    "0200 000080c0 0000a040 0000c040 00000000 000000bf 0000403f"
    "01000400 0200 0000e040 000000c1 00001041 00002041 0000a0c1 0000f041"
    "570f aabbccdd"
)  # fmt: skip

# What ports of YARP 3.12.3 sent: the port's number; a vector of six with an envelope; a mixed bottle without one.
YARP_NUMBER = bytes.fromhex("5941062900005250")
YARP_HEAD = bytes.fromhex("59410a0000005250")
YARP_VECTOR = YARP_HEAD + bytes.fromhex(
    "0301ffffffffffffffff1f0000000800000030000000 00000000"
    "170000007e0000014420323336203137393533353334 35322e333030363100"
    "0a01000006000000"
    "3166e2727bcf1940000000000000c0bf0000000000003e40"
    "9a9999999999b93f48afbc9af2d77a3e555555555555d5bf"
)
YARP_VALUES = (6.452619357174215, -0.125, 30.0, 0.1, 1e-07, -1 / 3)
YARP_MIXED = YARP_HEAD + bytes.fromhex(
    "0201ffffffffffffffff080000004000000000000000 000000007e440001 0001000006000000"
    "0a000000000000000000e03f 01000000feffffff 0100000003000000 0100000004000000 0a0000000000000000001540 0100000006000000"
)


def yarp_message(payload, seq=None, stamp=0.0):
    """A message with an envelope where it has a number."""
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

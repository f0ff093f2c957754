"""Images, point clouds and MultiArrays give the numbers that their own fields describe, or a sentence."""

import struct

import numpy as np
import pytest

from skincal.model.readings import Stream
from skincal.ros.layouts import RunReader
from skincal.ros.messages import MessageReader, is_seldom_a_skin, number_fields, streams_of
from skincal.ros.types import MessageError, MessageTypes
from tests.skincal.ros_support import make_message

IMAGE, CLOUD, BYTES = "sensor_msgs/msg/Image", "sensor_msgs/msg/PointCloud2", "std_msgs/msg/ByteMultiArray"
HEADER = {"stamp": {"sec": 5, "nanosec": 0}, "frame_id": "skin"}


def read(type_name, content, field="", ros=2):
    types = MessageTypes(ros)
    reader = MessageReader(types, type_name, Stream.SKIN, field)
    message = make_message(types, type_name, content)
    if ros == 2:
        message = types.decode(types.encode(message, type_name), type_name)
    values = reader.values_of(message)
    assert values is not None
    return values.tolist()


def dims(*sizes_and_strides):
    return [{"label": "", "size": size, "stride": stride} for size, stride in sizes_and_strides]


@pytest.mark.parametrize(
    ("layout", "expected"),
    [
        ({"dim": [], "data_offset": 0}, range(16)),
        ({"dim": [], "data_offset": 4}, range(4, 16)),
        ({"dim": dims((3, 12), (4, 4)), "data_offset": 4}, range(4, 16)),
        # Rows of three numbers and one of padding; the last row lacks its padding.
        ({"dim": dims((4, 16), (3, 4)), "data_offset": 1}, [1, 2, 3, 5, 6, 7, 9, 10, 11, 13, 14, 15]),
        # Twelve numbers, then a check sum of four bytes.
        ({"dim": dims((12, 12)), "data_offset": 0}, range(12)),
        # (2, 2, 3): data[offset + stride 1 * i + stride 2 * j + k], where the stride of dimension 2 is 3.
        ({"dim": dims((2, 16), (2, 8), (3, 4)), "data_offset": 0}, [0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14]),
        # Filled wrongly: all numbers count.
        ({"dim": dims((4, 16), (4, 1)), "data_offset": 0}, range(16)),
        ({"dim": dims((40, 40)), "data_offset": 2}, range(2, 16)),
        ({"dim": dims((0, 0)), "data_offset": 0}, range(16)),
        ({"dim": dims((16, 0)), "data_offset": 0}, range(16)),
    ],
)
def test_multi_arrays_are_read_by_their_layout(layout, expected):
    for kind in ("UInt8", "Float32", "Int16"):
        content = {"layout": layout, "data": list(range(16))}
        assert read(f"std_msgs/msg/{kind}MultiArray", content) == list(expected)
        assert read(f"std_msgs/msg/{kind}MultiArray", content, "data") == list(expected)
    reader = MessageReader(MessageTypes(), "std_msgs/msg/UInt8MultiArray", Stream.SKIN)
    assert reader.values_of({"layout": layout, "data": list(range(16))}).tolist() == list(expected), "JSON"


def test_an_offset_beyond_the_data_is_refused():
    with pytest.raises(MessageError, match=r"its layout\.data_offset is 17, and its data has 16 elements"):
        read("std_msgs/msg/Int8MultiArray", {"layout": {"dim": [], "data_offset": 17}, "data": [0] * 16})


def test_many_messages_at_once_have_the_numbers_of_single_ones():
    types, name = MessageTypes(), "std_msgs/msg/Float32MultiArray"
    for offsets in ([0] * 20, [3] * 20, [0] * 10 + [3] * 10):
        data = [
            types.encode(
                make_message(types, name, {"layout": {"dim": [], "data_offset": k}, "data": list(range(i, i + 8))}), name
            )
            for i, k in enumerate(offsets)
        ]
        reader = MessageReader(types, name, Stream.SKIN)
        found = RunReader(types, reader).read(data)
        assert (found is not None) == (not any(offsets)), "the fast way is for plain data alone"
        if found is not None:
            assert np.array_equal(found[0], [reader.values_of(types.decode(each, name)) for each in data])


def test_octets_of_ros_2_have_no_sign_and_bytes_of_ros_1_have_one():
    content = {"layout": {"dim": [], "data_offset": 0}, "data": [0, 127, 128, 255]}
    assert read(BYTES, content) == [0, 127, 128, 255]
    types = MessageTypes(1)
    # Serialisation of ROS 1: no dimension, no offset, four bytes.
    message = types.decode(struct.pack("<III4B", 0, 0, 4, 0, 127, 128, 255), BYTES)
    assert MessageReader(types, BYTES, Stream.SKIN).values_of(message).tolist() == [0, 127, -128, -1]
    own = MessageTypes()
    own.add_definition("lab/msg/Skin", "byte[] raw\nbyte one\nchar[] letters\n")
    decoded = own.decode(own.encode(own.make("lab/msg/Skin", raw=np.array([200, 3], "u1")), "lab/msg/Skin"), "lab/msg/Skin")
    assert MessageReader(own, "lab/msg/Skin", Stream.SKIN).values_of(decoded).tolist() == [200, 3]


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(
    ("encoding", "dtype"), [("mono8", "u1"), ("mono16", "u2"), ("16SC1", "i2"), ("32FC1", "f4"), ("64FC1", "f8")]
)
@pytest.mark.parametrize("padding", [0, 3])
def test_images_are_read_by_their_encoding(encoding, dtype, order, padding):
    pixels = np.array([[1, 2, 3, 250], [5, 6, 7, 8], [9, 10, 11, 12]], f"{order}{dtype}")
    rows = b"".join(row.tobytes() + b"\xee" * padding for row in pixels)
    step = 4 * pixels.dtype.itemsize + padding
    for data in {rows, rows[: len(rows) - padding]}:
        content = {
            "header": HEADER,
            "height": 3,
            "width": 4,
            "encoding": encoding,
            "is_bigendian": int(order == ">"),
            "step": step,
        }
        content["data"] = list(data)
        assert read(IMAGE, content) == read(IMAGE, content, "data") == pixels.astype(float).ravel().tolist()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"encoding": "rgb8"}, "its encoding is 'rgb8'; expected one of mono8, mono16"),
        ({"step": 3}, "8 bytes of data are no 2 x 2 elements of 2 bytes"),
        ({"height": 3}, "8 bytes of data are no 3 x 2 elements of 2 bytes"),
    ],
)
def test_images_that_do_not_fit_are_refused(change, words):
    content = {"header": HEADER, "height": 2, "width": 2, "encoding": "mono16", "is_bigendian": 0, "step": 4, "data": [0] * 8}
    with pytest.raises(MessageError, match=words):
        read(IMAGE, content | change)


def cloud(fields, points, order="<"):
    """A cloud of `points`, (n, fields); each field has name, datatype and numpy type."""
    offsets = np.cumsum([0, *(np.dtype(kind).itemsize for *_, kind in fields)]).tolist()
    data = b"".join(
        np.array(value, f"{order}{f[2]}").tobytes() for point in points for f, value in zip(fields, point, strict=True)
    )
    described = [
        {"name": name, "offset": at, "datatype": datatype, "count": 1}
        for (name, datatype, _), at in zip(fields, offsets, strict=False)
    ]
    shape = {"height": 1, "width": len(points), "point_step": offsets[-1], "row_step": offsets[-1] * len(points)}
    flags = {"is_bigendian": int(order == ">"), "is_dense": True}
    return {"header": HEADER, "fields": described, **shape, **flags, "data": list(data)}


PLACES = [("x", 7, "f4"), ("y", 7, "f4"), ("z", 7, "f4")]


@pytest.mark.parametrize("order", ["<", ">"])
def test_a_field_of_the_points_of_a_cloud_is_read(order):
    content = cloud([*PLACES, ("pressure", 4, "u2")], [(0.1, 0, 0, 40000), (0.2, 0, 0, 7)], order)
    assert read(CLOUD, content) == read(CLOUD, content, "pressure") == [40000, 7]
    np.testing.assert_allclose(read(CLOUD, content, "x"), [0.1, 0.2], rtol=1e-6)
    with pytest.raises(MessageError, match="its points have no field force, but x, y, z, pressure"):
        read(CLOUD, content, "force")
    both = cloud([*PLACES, ("pressure", 4, "u2"), ("heat", 8, "f8")], [(0, 0, 0, 3, 20.5)], order)
    with pytest.raises(MessageError, match=r"the fields x, y, z, pressure, heat; choose one: TOPIC\?field=NAME"):
        read(CLOUD, both)
    assert read(CLOUD, both, "heat") == [20.5]
    assert read(CLOUD, both, "pressure") == [3]


def test_other_standard_types_are_read_by_their_usual_field_when_they_are_named():
    fluid = {"header": HEADER, "fluid_pressure": 101325.0, "variance": 0.0}
    assert read("sensor_msgs/msg/FluidPressure", fluid) == [101325.0]
    assert read("std_msgs/msg/Float32", {"data": 2.5}) == [2.5]
    points = {"header": HEADER, "points": [], "channels": [{"name": "pressure", "values": [1.0, 2.0]}]}
    assert read("sensor_msgs/msg/PointCloud", points) == [1, 2]
    for name in ("std_msgs/msg/UInt16", IMAGE, CLOUD):
        assert streams_of(MessageTypes(), name) == (Stream.SKIN,)
        assert is_seldom_a_skin(name)
    assert not is_seldom_a_skin("std_msgs/msg/Float32MultiArray")
    assert number_fields(MessageTypes(), "sensor_msgs/msg/MagneticField")[0] == "magnetic_field_covariance"

"""Numbers of messages whose other fields say how their data is laid out: MultiArrays, images and point clouds.

    std_msgs MultiArray     data from `layout.data_offset` on, without the padding of the strides
    Image                   the pixels, row by row: mono8, mono16, 8UC1, 8SC1, 16UC1, 16SC1, 32SC1, 32FC1, 64FC1
    PointCloud2             one field of each point: the named one, else the only one that is no position or colour

Sources: comments of `std_msgs/MultiArrayLayout`, `sensor_msgs/Image` and `sensor_msgs/PointField`; image_encodings.hpp.
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from skincal.geometry import FloatArray
from skincal.ros.types import MessageError

IMAGE_TYPE = "sensor_msgs/msg/Image"
POINT_CLOUD_TYPE = "sensor_msgs/msg/PointCloud2"
PIXEL_DTYPES = {
    "mono8": "u1", "mono16": "u2", "8UC1": "u1", "8SC1": "i1", "16UC1": "u2", "16SC1": "i2", "32SC1": "i4", "32FC1": "f4",
    "64FC1": "f8",
}  # fmt: skip
POINT_FIELD_DTYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
POSITIONS_AND_COLOURS = ("x", "y", "z", "rgb", "rgba", "normal_x", "normal_y", "normal_z", "curvature", "ring", "time", "t")
"""Fields of points that are no readings, unless one is named."""

EMPTY_LAYOUT: dict[str, Any] = {"data_offset": 0, "dim": []}


def elements_of_array(layout: Any, count: int) -> NDArray[np.intp] | None:
    """Compute the indices of the elements of a MultiArray of `count` numbers, in order; `None` for all of them.

    Dimensions that do not fit the data are ignored, since many publishers leave them empty or fill them wrongly. A layout in
    JSON may be empty.

    Raises MessageError: its offset is beyond the data.
    """
    if isinstance(layout, dict):
        layout = EMPTY_LAYOUT | cast("dict[str, Any]", layout)
    offset = int(_get(layout, "data_offset"))
    if offset > count:
        raise MessageError(f"its layout.data_offset is {offset}, and its data has {count} elements")
    sizes = [int(_get(each, "size")) for each in _get(layout, "dim")]
    # The first stride is the size of the whole array, and no step.
    steps = [*(int(_get(each, "stride")) for each in _get(layout, "dim")[1:]), 1]
    is_nested = bool(sizes) and min(sizes) > 0
    extent = 1
    for size, step in zip(reversed(sizes), reversed(steps), strict=False):
        is_nested = is_nested and step >= extent
        extent = step * size
    if is_nested and offset + sum((size - 1) * step for size, step in zip(sizes, steps, strict=True)) < count:
        found = np.array([offset])
        for size, step in zip(sizes, steps, strict=True):
            found = (found[:, None] + step * np.arange(size)).ravel()
        return None if len(found) == count else found
    return np.arange(offset, count) if offset else None


def pixels_of(image: Any) -> FloatArray:
    """Read the pixels of an image of one channel, row by row. Raises MessageError: its encoding or sizes are others."""
    encoding = str(_get(image, "encoding"))
    dtype = PIXEL_DTYPES.get(encoding)
    if dtype is None:
        raise MessageError(f"its encoding is {encoding!r}; expected one of {', '.join(PIXEL_DTYPES)}")
    return _table(image, int(_get(image, "step")), np.dtype(dtype).itemsize, [0], dtype)


def points_of(cloud: Any, name: str) -> FloatArray:
    """Read a field of all points, point by point; without a name, the only one that is no position or colour.

    Raises MessageError: there is no such field, or several.
    """
    fields = {str(_get(each, "name")): each for each in _get(cloud, "fields")}
    readings = [each for each in fields if each not in POSITIONS_AND_COLOURS]
    if not name and len(readings) != 1:
        seen = ", ".join(fields) or "none"
        raise MessageError(f"its points have the fields {seen}; choose one: TOPIC?field=NAME")
    if name and name not in fields:
        raise MessageError(f"its points have no field {name}, but {', '.join(fields) or 'none'}")
    field = fields[name or readings[0]]
    dtype = POINT_FIELD_DTYPES.get(int(_get(field, "datatype")))
    if dtype is None:
        raise MessageError(f"the field {name or readings[0]} has an unknown type ({_get(field, 'datatype')})")
    # Some publishers leave the count of a single number at 0.
    count, offset = max(1, int(_get(field, "count"))), int(_get(field, "offset"))
    offsets = [offset + np.dtype(dtype).itemsize * k for k in range(count)]
    return _table(cloud, int(_get(cloud, "row_step")), int(_get(cloud, "point_step")), offsets, dtype)


def _table(message: Any, row_bytes: int, item_bytes: int, offsets: Sequence[int], dtype: str) -> FloatArray:
    """Read numbers at the same offsets of each item in rows with padding, (height * width * offsets,) float."""
    height, width = int(_get(message, "height")), int(_get(message, "width"))
    raw = _get(message, "data")
    data = np.asarray(raw).astype(np.uint8) if not isinstance(raw, str) else _from_base64(raw)
    size = np.dtype(dtype).itemsize
    rows_fit = height * width == 0 or (
        row_bytes >= width * item_bytes and len(data) >= (height - 1) * row_bytes + width * item_bytes
    )
    if not rows_fit or max(offsets) + size > item_bytes:
        raise MessageError(f"{len(data)} bytes of data are no {height} x {width} elements of {item_bytes} bytes")
    # The last row may lack its padding.
    padded = np.zeros(height * row_bytes, np.uint8)
    padded[: min(len(data), len(padded))] = data[: len(padded)]
    items = padded.reshape(height, row_bytes)[:, : width * item_bytes].reshape(height * width, item_bytes)
    order = ">" if _get(message, "is_bigendian") else "<"
    parts = [np.ascontiguousarray(items[:, at : at + size]).view(f"{order}{dtype}") for at in offsets]
    return np.hstack(parts).astype(np.float64).ravel() if parts else np.empty(0)


def _from_base64(text: str) -> NDArray[np.uint8]:
    try:
        return np.frombuffer(base64.b64decode(text, validate=True), np.uint8)
    except binascii.Error:
        raise MessageError("its data is no text in base64") from None


def _get(value: Any, name: str) -> Any:
    """Return a field of a message, which is an object or a JSON object. Raises MessageError: it is missing."""
    try:
        return cast("dict[str, Any]", value)[name] if isinstance(value, dict) else getattr(value, name)
    except (KeyError, AttributeError):
        raise MessageError(f"the field {name} is missing") from None

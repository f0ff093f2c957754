"""Messages and bags of ROS for tests, written by `rosbags`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from skincal.ros.types import MessageTypes

BAG_KINDS = ("sqlite3", "mcap", "mcap-zstd", "sqlite3-message", "sqlite3-file", "ros1", "ros1-bz2", "ros1-lz4")
WRENCH_TYPE, JOINTS_TYPE = "geometry_msgs/msg/WrenchStamped", "sensor_msgs/msg/JointState"
SKIN_TYPE = "std_msgs/msg/Float32MultiArray"
LAYOUT = {"dim": [], "data_offset": 0}
JOINT_NAMES = ("j0", "j1", "j2", "j3", "j4")


def make_message(types: MessageTypes, type_name: str, content: Mapping[str, Any]) -> Any:
    """Make the message object of a JSON object, in the classes of the type system."""
    made: dict[str, Any] = {}
    for field in types.fields_of(type_name):
        value = content.get(field.name, 0)
        if field.kind == "message":
            made[field.name] = (
                [make_message(types, field.type_name, each) for each in value]
                if field.is_array
                else make_message(types, field.type_name, value)
            )
        elif field.is_array and field.kind == "number":
            made[field.name] = np.array(value, "u1" if field.type_name in ("byte", "char") else field.type_name)
        else:
            made[field.name] = value
    return types._store.types[type_name](**made)


def header(stamp_ns: int) -> dict[str, Any]:
    return {"stamp": {"sec": stamp_ns // 10**9, "nanosec": stamp_ns % 10**9}, "frame_id": "ft"}


def wrench_message(stamp_ns: int, values: Iterable[float]) -> dict[str, Any]:
    numbers = [float(value) for value in values]
    force, torque = (dict(zip("xyz", part, strict=True)) for part in (numbers[:3], numbers[3:]))
    return {"header": header(stamp_ns), "wrench": {"force": force, "torque": torque}}


def joints_message(stamp_ns: int, radians: Iterable[float], names: Iterable[str] = JOINT_NAMES) -> dict[str, Any]:
    return {"header": header(stamp_ns), "name": list(names), "position": list(radians), "velocity": [], "effort": []}


def skin_message(values: Iterable[float]) -> dict[str, Any]:
    return {"layout": LAYOUT, "data": list(values)}


class BagFile:
    """A bag that is written message by message.

    Parameters
    ----------
    path : folder of ROS 2 or file of ROS 1
    definitions : of own types, by name
    """

    def __init__(self, path: Path, kind: str, definitions: Mapping[str, str] | None = None) -> None:
        self.path = path if not kind.startswith("ros1") else path.with_suffix(".bag")
        self.is_ros1 = kind.startswith("ros1")
        self.types = MessageTypes(1 if self.is_ros1 else 2)
        self.store = get_typestore(Stores.ROS1_NOETIC if self.is_ros1 else Stores.ROS2_HUMBLE)
        for name, text in (definitions or {}).items():
            self.types.add_definition(name, text)
            self.store.register(get_types_from_msg(text, name))
        storage, _, compression = kind.partition("-")
        if self.is_ros1:
            self.writer: Any = Writer1(self.path)
            if compression:
                self.writer.set_compression(Writer1.CompressionFormat[compression.upper()])
        else:
            self.writer = Writer2(self.path, version=9, storage_plugin=StoragePlugin[storage.upper()])
            mode = {"zstd": "STORAGE", "message": "MESSAGE", "file": "FILE"}.get(compression)
            if mode:
                self.writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
        self.connections: dict[tuple[str, str], Any] = {}

    def add(self, topic: str, type_name: str, arrival_ns: int, content: Mapping[str, Any]) -> None:
        message = make_message(self.types, type_name, content)
        serialize = self.store.serialize_ros1 if self.is_ros1 else self.store.serialize_cdr
        self.add_bytes(topic, type_name, arrival_ns, bytes(serialize(message, type_name)))

    def add_bytes(self, topic: str, type_name: str, arrival_ns: int, data: bytes) -> None:
        key = topic, type_name
        if key not in self.connections:
            self.connections[key] = self.writer.add_connection(topic, type_name, typestore=self.store)
        self.writer.write(self.connections[key], arrival_ns, data)

    def __enter__(self) -> BagFile:
        self.writer.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.writer.close()

"""Definitions of ROS messages by type name, and messages from their bytes: CDR of ROS 2, and the serialisation of ROS 1.

The standard definitions and the readers are those of `rosbags`, which is imported with the first `MessageTypes`. Added are the
types of tactile skins: `tactile_msgs/TactileState` (ubi-agni/tactile_toolbox, `tactile_msgs/msg`) and XELA's `SensStream`
(mcsix/xela_server_ros2, `msg`). A laboratory's own type comes with a recording, or from its `.msg` file.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np

from skincal.model.errors import InputError
from skincal.model.given import read_regular

MAX_DEFINITION_BYTES = 1 << 20
"""Of the definition of a type with those of its parts; the longest standard one has 40,000."""
MAX_ARRAY_ELEMENTS = 1 << 24
"""Of an array in a message: a skin of 100,000 channels has far fewer. A damaged length must not fill the memory."""
SECTION_END = "=" * 80
"""Line between the definitions of a type and its parts, as bags carry them."""
TIME_TYPES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
HEADER_TYPE = "std_msgs/msg/Header"
_STORE_NAMES: dict[int, str] = {1: "ros1_noetic", 2: "ros2_humble"}
XELA_PACKAGES = ("xela_server_ros2", "xela_server_ros")
"""Of ROS 2 and ROS 1."""
_XELA_DEFINITIONS = {
    "Forces": "float32 x\nfloat32 y\nfloat32 z\n",
    "Taxel": "uint16 x\nuint16 y\nuint16 z\n",
    "SensorFull": "uint32 message\nfloat64 time\nstring model\nuint8 sensor_pos\nTaxel[] taxels\nForces[] forces\n",
    "SensStream": "SensorFull[] sensors\n",
}
_SKIN_DEFINITIONS = {
    "tactile_msgs/msg/TactileState": "std_msgs/Header header\nsensor_msgs/ChannelFloat32[] sensors\n",
    **{f"{package}/msg/{name}": text for package in XELA_PACKAGES for name, text in _XELA_DEFINITIONS.items()},
}
_NAME_RE = re.compile(r"[A-Za-z]\w*/(?:msg/)?[A-Za-z]\w*")
_DDS_NAME_RE = re.compile(r"^(\w+)/msg/dds_/(\w+)_$")
_IDL_SKIPPED_LINES_RE = re.compile(r"^(#|={80}|IDL: ).*$", re.MULTILINE)
"""Preprocessor's lines, which the parser does not know, and the heads of the parts in a bag."""
_PART_RE = re.compile(r"^\s*(?:([A-Za-z]\w*)/(?:msg/)?)?([A-Za-z]\w*)(?:\[[^\]]*\])?\s+[a-z]\w*", re.MULTILINE)
"""A field: package, or `None`, and type. Base types match, too; no file has their names."""


class MessageError(ValueError):
    """A message cannot be read; the message is a sentence without the topic."""


@dataclass(frozen=True, slots=True)
class Field:
    """A field of a message."""

    name: str
    kind: Literal["number", "text", "message"]
    type_name: str
    """Of a message: its type; else the base type, such as `float32`."""
    is_array: bool
    length: int = 0
    """Of an array with a fixed number of elements; 0 for others."""


def full_type_name(name: str) -> str:
    """Write `package/Type` as `package/msg/Type`, and DDS's `package/msg/dds_/Type_`. Raises InputError: it is no type name."""
    name = _DDS_NAME_RE.sub(r"\1/msg/\2", name)
    if not _NAME_RE.fullmatch(name):
        raise InputError(f"{name!r} is no type of a ROS message; expected package/msg/Type, such as std_msgs/msg/Header.")
    package, *_, last = name.split("/")
    return f"{package}/msg/{last}"


def read_definition(path: Path, type_name: str) -> str:
    """Read the definition of a type from its `.msg` file, with those of its parts, as a bag carries it.

    Parts of the same package are next to it; those of another one are in `../../PACKAGE/msg`.

    Raises InputError: a file cannot be read.
    """
    path = path.absolute()
    own = (full_type_name(type_name).split("/")[0], path.stem)
    texts, waiting = dict[tuple[str, str], str](), {own: path}
    while waiting:
        key, file = waiting.popitem()
        data = read_regular(file, MAX_DEFINITION_BYTES, advice="expected the .msg file of the type")
        texts[key] = text = data.decode(errors="replace")
        for found in _PART_RE.finditer(text):
            part = (found[1] or key[0], found[2])
            folder = file.parent if part[0] == key[0] else file.parent.parent.parent / part[0] / "msg"
            if part not in texts and (near := folder / f"{part[1]}.msg").is_file():
                waiting[part] = near
    first = texts.pop(own)
    return "\n".join([first, *(f"{SECTION_END}\nMSG: {'/'.join(key)}\n{text}" for key, text in sorted(texts.items()))])


@cache
def _standard_definitions(ros: Literal[1, 2]) -> tuple[frozenset[str], Mapping[str, Any]]:
    """Find the names of the types of ROS itself, and by name the fields of these types and of those of a tactile skin."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores(_STORE_NAMES[ros]))
    own = frozenset(store.fielddefs)
    for name, text in _SKIN_DEFINITIONS.items():
        store.register(_parse_definition(name, text))
    return own, store.fielddefs


class MessageTypes:
    """Message definitions of one version of ROS, and the messages in bytes.

    A type that is not added is a standard one, or one of a tactile skin.

    Parameters
    ----------
    ros : 1 or 2; a header of ROS 1 has a counter, too

    Raises InputError: the package `rosbags` is missing.
    """

    def __init__(self, ros: Literal[1, 2] = 2) -> None:
        try:
            from rosbags.typesys import Stores, get_typestore
        except ImportError:
            raise InputError(
                "Messages of ROS are read by the package rosbags, which is not installed; install it: "
                "python -m pip install 'skincal[rosbag]' (or python3 start.py --rosbag)"
            ) from None
        self.ros = ros
        self._store = get_typestore(Stores.EMPTY)
        self._store.max_sequence_length = MAX_ARRAY_ELEMENTS
        self._of_ros, self._standard = _standard_definitions(ros)
        self._complete = set[str]()
        """Full names of types that are in the store with their parts."""

    def is_standard(self, type_name: str) -> bool:
        """Return whether ROS itself defines a type of this name."""
        return full_type_name(type_name) in self._of_ros

    def add_definition(self, type_name: str, text: str, language: Literal["msg", "idl"] = "msg") -> None:
        """Add a type from its definition in the language of `.msg` files, or in IDL; its parts may follow as in a bag.

        Raises InputError: the text is no definition, or another one of the type or of a part was added before.
        """
        from rosbags.typesys import TypesysError

        name = full_type_name(type_name)
        try:
            self._store.register(_parse_idl(name, text) if language == "idl" else _parse_definition(name, text))
        except TypesysError as error:
            raise InputError(f"{name}: {' '.join(str(error).split())} Expected one definition of each type.") from None

    def add_file(self, path: Path, type_name: str) -> None:
        """Add a type from its `.msg` file; those of its parts are looked for next to it.

        Raises InputError: a file cannot be read, or is no definition.
        """
        text = read_definition(path, type_name)
        try:
            self.add_definition(type_name, text)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None

    def fields_of(self, type_name: str) -> tuple[Field, ...]:
        """List the fields of a type in order. Raises MessageError: it, or a part of it, has no definition."""
        name = self._require(type_name)
        return tuple(_field_of(*each) for each in self._store.fielddefs[name][1])

    def decode(self, data: bytes | memoryview, type_name: str) -> Any:
        """Read a message from its bytes: CDR, or the serialisation of ROS 1. Its fields are attributes, arrays are of numpy.

        Raises MessageError: the bytes are no message of this type, or the type has no definition.
        """
        from rosbags.serde import SerdeError

        name = self._require(type_name)
        read = self._store.deserialize_cdr if self.ros == 2 else self._store.deserialize_ros1
        try:
            return read(data, name)
        except KeyError as error:
            raise _undefined(str(error.args[0])) from None
        except (SerdeError, IndexError, OverflowError, MemoryError, RecursionError, AssertionError, ValueError):
            raise MessageError(f"{len(data)} bytes are no message of the type {name}") from None

    def make(self, type_name: str, **values: Any) -> Any:
        """Make a message of the values of some fields; the others are 0, false or empty."""
        name = self._require(type_name)
        zeros = {field.name: self._zero(field) for field in self.fields_of(name) if field.name not in values}
        return self._store.types[name](**zeros, **values)

    def _zero(self, field: Field) -> Any:
        if field.is_array and field.kind == "number":
            return np.zeros(field.length, np.uint8 if field.type_name in ("byte", "octet", "char") else field.type_name)
        zero = 0.0 if field.type_name.startswith("float") else field.type_name != "bool" and 0
        one = self.make(field.type_name) if field.kind == "message" else "" if field.kind == "text" else zero
        return [one] * field.length if field.is_array else one

    def encode(self, message: Any, type_name: str) -> bytes:
        """Write a message of ROS 2 as CDR."""
        return bytes(self._store.serialize_cdr(message, self._require(type_name)))

    def _require(self, type_name: str) -> str:
        """Return the full name of a type; a standard one is added with its parts. Raises MessageError: it is unknown."""
        if type_name in self._complete:
            return type_name
        name = full_type_name(type_name)
        waiting, seen = [name], set[str]()
        while waiting:
            each = waiting.pop()
            if each in seen:
                continue
            seen.add(each)
            if each not in self._store.fielddefs:
                if each not in self._standard:
                    raise _undefined(each)
                self._store.register({each: self._standard[each]})
            parts = (_field_of(*one) for one in self._store.fielddefs[each][1])
            waiting += [field.type_name for field in parts if field.kind == "message"]
        self._complete.add(name)
        return name


@lru_cache(maxsize=1024)
def _field_of(name: str, description: Any) -> Field:
    """Describe a field from the type system's description of it."""
    from rosbags.interfaces import Nodetype

    is_array = description[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE)
    length = description[1][1] if description[0] == Nodetype.ARRAY else 0
    node, detail = description[1][0] if is_array else description
    if node == Nodetype.NAME:
        return Field(name, "message", detail, is_array, length)
    return Field(name, "text" if detail[0] in ("string", "wstring") else "number", detail[0], is_array, length)


def _undefined(name: str) -> MessageError:
    return MessageError(f"the type {name} has no definition here; add its .msg file to the topic: TOPIC?msg=FILE")


@lru_cache(maxsize=256)
def _parse_definition(name: str, text: str) -> Any:
    """Parse the text of a `.msg` file; a recording that is opened again, or in many files, names the same definitions."""
    from rosbags.typesys import TypesysError, get_types_from_msg

    if len(text) > MAX_DEFINITION_BYTES:
        raise InputError(f"{name}: its definition has {len(text)} letters; expected at most {MAX_DEFINITION_BYTES}.")
    try:
        return get_types_from_msg(text, name)
    except (TypesysError, RecursionError, ValueError, KeyError, IndexError):
        raise InputError(f"{name}: its definition cannot be read; expected the text of a .msg file.") from None


def _parse_idl(name: str, text: str) -> Any:
    """Read the types of an IDL text, those of its parts included. Raises InputError: it is none, or lacks the type."""
    from rosbags.interfaces import Nodetype
    from rosbags.typesys import TypesysError, get_types_from_idl

    if len(text) > MAX_DEFINITION_BYTES:
        raise InputError(f"{name}: its definition has {len(text)} letters; expected at most {MAX_DEFINITION_BYTES}.")

    def renamed(node: Any) -> Any:
        kind, detail = node
        if kind == Nodetype.NAME:
            return kind, full_type_name(detail)
        return (kind, (renamed(detail[0]), detail[1])) if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) else node

    try:
        parsed = get_types_from_idl(_IDL_SKIPPED_LINES_RE.sub("", text))
        found = {
            full_type_name(each): (constants, [(field, renamed(node)) for field, node in fields])
            for each, (constants, fields) in parsed.items()
        }
    except (TypesysError, RecursionError, ValueError, KeyError, IndexError, InputError):
        raise InputError(f"{name}: its definition cannot be read; expected IDL.") from None
    if name not in found:
        raise InputError(f"{name}: its definition in IDL has {', '.join(found) or 'no type'}; expected {name}.")
    return found

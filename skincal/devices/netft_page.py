"""Page `netftapi2.xml` of an ATI sensor: counts per unit, units, ranges, tool transform, and the meaning of the status bits.

A box may report the wrench in another frame than the sensor's own: the tool transform `cfgtfx` moves the point of the moments
by Dx Dy Dz (unit `scfgtdu`), then turns the axes by Rx Ry Rz (unit `scfgtau`). In ATI's own C library (ATIDAQ, `ftconfig.c`,
`TTM`) the reported wrench is f' = R f, m' = R (m - d x f), with

    R = | cy cz    sx sy cz + cx sz    sx sz - cx sy cz |
        | -cy sz   cx cz - sx sy sz    sx cz + cx sy sz |
        | sy       -sx cy              cx cy            |

So f = R' f', m = R' m' + d x f is the wrench about the sensor's own origin, the one that `[sensor]` in a scene means.

Sources: ATI manuals 9620-05 (Net F/T) and 9610-05 (Axia), public clients of both, a public page of a Gamma (firmware 2.2.59).
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from skincal.geometry import FloatArray, cross_matrix

FORCE_UNITS = {"n": 1.0, "kn": 1e3, "lb": 4.4482216152605, "klb": 4448.2216152605, "kg": 9.80665, "g": 9.80665e-3}
"""N, by the unit's name in small letters without marks and the f of force."""
TORQUE_UNITS = {
    "nm": 1.0,
    "nmm": 1e-3,
    "knm": 1e3,
    "lbin": 0.1129848290276167,
    "lbft": 1.3558179483314004,
    "inlb": 0.1129848290276167,
    "ftlb": 1.3558179483314004,
    "kgcm": 0.0980665,
    "kgm": 9.80665,
}
"""N m, by the unit's name in the same form."""
LENGTH_UNITS = {"in": 0.0254, "ft": 0.3048, "mm": 1e-3, "cm": 1e-2, "m": 1.0}
"""m, by the unit's name."""
ANGLE_UNITS = {
    **dict.fromkeys(("deg", "degree", "degrees"), math.radians(1.0)),
    **dict.fromkeys(("rad", "radian", "radians"), 1.0),
}
"""rad, by the unit's name."""
FILTER_HZ_OF_CODE = {1: 838, 2: 326, 3: 152, 4: 73, 5: 35, 6: 18, 7: 8, 8: 5, 9: 1500, 10: 2000, 11: 2500, 12: 3000}
"""Hz, cut-off of the box's low-pass filter by the number in `setuserfilter`; 0 is no filter."""
MIN_TORQUE_COUNTS_SHARE = 0.01
"""Counts for each N m over those for each N. Boxes have 1 by default, a HEX has 10; counts for N mm look like 0.001."""
KEEP_TRANSFORM = "<skincal>keep</skincal>"
"""Added to the stored page if the operator chose to read wrenches in the frame of the tool transform."""
ANY_ERROR_BIT = 1 << 31
MONITOR_BIT = 1 << 16


@dataclass(frozen=True, slots=True)
class StatusTable:
    """Meaning of the bits of a status word."""

    saturated: int
    """Bits of a force or torque beyond the range."""
    harmless: int
    """Bits that are no error."""
    unnamed: int
    """Bits that say nothing to the operator."""
    words: Mapping[int, str]
    """Sentences by the number of the bit."""


NET_FT_STATUS = StatusTable(
    1 << 17,
    MONITOR_BIT | ANY_ERROR_BIT,
    ANY_ERROR_BIT,
    {
        1: "its web server failed",
        2: "its temperature is out of range",
        3: "its reference voltage or power supply has a fault",
        4: "its serial link has no data",
        5: "the supply of its analog board is too low",
        6: "the supply of its analog board is too high",
        7: "its artificial analog ground is out of range",
        8: "the excitation current of its strain gages is too low",
        9: "the excitation current of its strain gages is too high",
        10: "the watchdog of its analog board ran out",
        11: "its serial flash failed",
        12: "its serial EEPROM failed",
        13: "its stack check failed",
        14: "its watchdog ran out",
        16: "a monitored condition was met",
        17: "saturated: the force or torque is beyond the sensor's range",
        18: "its DeviceNet failed",
        19: "its EtherNet/IP failed",
        20: "its RDT connection failed",
        21: "its CAN connection failed",
        22: "its network failed",
        23: "its configuration does not fit its calibration",
        24: "its settings are not valid",
        25: "it stopped because of its configuration",
        26: "its program memory failed",
        27: "its serial link failed",
        28: "its analog board failed",
        29: "its digital board failed",
        30: "its processor or memory failed",
    },
)
AXIA_BUSY_BIT = 1 << 3
AXIA_STATUS = StatusTable(
    1 << 27 | 1 << 30,
    MONITOR_BIT | ANY_ERROR_BIT | AXIA_BUSY_BIT,
    ANY_ERROR_BIT | AXIA_BUSY_BIT,
    {
        0: "its temperature is out of range",
        1: "its supply voltage is out of range",
        2: "a strain gage is broken",
        5: "an error of its hardware",
        7: "its calibration cannot be read",
        16: "a monitored condition was met",
        27: "a strain gage is beyond its range",
        28: "it sends simulated readings",
        29: "its calibration has a wrong checksum",
        30: "the force or torque is beyond its range",
    },
)
ALL_BITS = (1 << 32) - 1
HEX_STATUS = StatusTable(0, ALL_BITS, ANY_ERROR_BIT, {})
"""No public text of OnRobot explains its bits: they are shown, and no reading is rejected for them."""


@dataclass(frozen=True, slots=True)
class SensorPage:
    """Settings of a sensor, as its page names them."""

    per_newton: float
    """Counts per N."""
    per_newton_metre: float
    """Counts per N m."""
    product: str
    table: StatusTable
    limits: tuple[float, ...]
    """Ranges of Fx Fy Fz (N) and Tx Ty Tz (N m); empty if the page names none, or if a tool transform turns or moves them."""
    own_from_reported: FloatArray | None
    """(6, 6): carries a reported wrench to the sensor's own frame; `None` if it is in this frame already."""
    frame_words: str
    """Words on the frame of the wrenches; empty if it is the sensor's own without a tool transform."""
    notice: str
    """Sentence for the operator on the tool transform, or on counts that look wrong; empty without both."""
    settings: str
    """Serial number, rate and filter; empty if the page names none."""


def read_page(page: bytes) -> SensorPage:
    """Read `netftapi2.xml`.

    Raises
    ------
    ValueError
        It lacks the counts, or has a unit or a tool transform that cannot be read; the message is a sentence without an end.
    """
    text = page.decode("utf-8", "replace")
    product = _field(text, "prodname") or "Net F/T"
    kind = product.lower()
    table = HEX_STATUS if "hex" in kind else AXIA_STATUS if "axia" in kind else NET_FT_STATUS
    per_unit: list[float] = []
    sizes: list[float] = []
    for counts, unit, default, units in (
        ("cfgcpf", "scfgfu", "N", FORCE_UNITS),
        ("cfgcpt", "scfgtu", "Nm", TORQUE_UNITS),
    ):
        found = _field(text, unit)
        name = re.sub("[^a-z]", "", (found or default).lower()).replace("lbf", "lb").replace("gf", "g")
        size = units.get(name)
        number = _number(_field(text, counts))
        if size is None:
            raise ValueError(f"its page names the unit {found[:20]!r}; expected one of {', '.join(units)}")
        if not 0 < number < 1 << 32:
            raise ValueError(f"its page gives no {counts}, the counts for each unit")
        per_unit.append(number / size)
        sizes.append(size)
    own_from_reported, frame_words, notice = _read_transform(text, is_hex=table is HEX_STATUS)
    has_transform = bool(notice)
    if per_unit[1] < MIN_TORQUE_COUNTS_SHARE * per_unit[0]:
        notice = notice or (
            f"There are {per_unit[1]:g} counts for each N m and {per_unit[0]:g} for each N: if the first are for N mm, moments "
            "are 1000 times too large; then give 1000 times as many by cpt"
        )
    ranges = _numbers(_field(text, "cfgmr"))
    has_limits = not has_transform and len(ranges) == 6 and all(0 < value < math.inf for value in ranges)
    limits = tuple(value * sizes[axis // 3] for axis, value in enumerate(ranges)) if has_limits else ()
    return SensorPage(
        per_newton=per_unit[0],
        per_newton_metre=per_unit[1],
        product=product[:60],
        table=table,
        limits=limits,
        own_from_reported=own_from_reported,
        frame_words=frame_words,
        notice=notice,
        settings=_settings_words(text),
    )


def given_page(per_newton: float, per_newton_metre: float, product: str) -> bytes:
    """Build the page of a sensor that serves none, from the counts of its data sheet."""
    return (
        f"<netft><prodname>{product}</prodname><cfgcpf>{per_newton:.17g}</cfgcpf><scfgfu>N</scfgfu>"
        f"<cfgcpt>{per_newton_metre:.17g}</cfgcpt><scfgtu>Nm</scfgtu></netft>"
    ).encode()


def keep_transform(page: bytes) -> bytes:
    """Mark a page: wrenches stay in the frame of the tool transform."""
    return KEEP_TRANSFORM.encode() + page


def tool_transform_matrix(offset: FloatArray, angles: FloatArray) -> FloatArray:
    """Make the matrix (6, 6) that carries a wrench reported through a tool transform to the sensor's own frame.

    Parameters
    ----------
    offset : (3,) float, m, Dx Dy Dz: the point of the reported moments in the sensor's frame
    angles : (3,) float, rad, Rx Ry Rz
    """
    (sx, sy, sz), (cx, cy, cz) = np.sin(angles), np.cos(angles)
    turn = np.array(
        [
            [cy * cz, sx * sy * cz + cx * sz, sx * sz - cx * sy * cz],
            [-cy * sz, cx * cz - sx * sy * sz, sx * cz + cx * sy * sz],
            [sy, -sx * cy, cx * cy],
        ]
    )
    own = np.zeros((6, 6))
    own[:3, :3] = own[3:, 3:] = turn.T
    own[3:, :3] = cross_matrix(offset) @ turn.T
    return own


def _read_transform(text: str, *, is_hex: bool) -> tuple[FloatArray | None, str, str]:
    """Read the tool transform: the matrix that undoes it, words on the frame, and the sentence. Raises ValueError."""
    written = _field(text, "cfgtfx")
    if not written:
        # A HEX has none. The page of a data sheet's counts cannot tell.
        return None, "" if is_hex else "its tool transform is not known and must be 0", ""
    numbers = _numbers(written)
    if len(numbers) != 6 or not all(map(math.isfinite, numbers)):
        raise ValueError(f"its page gives the tool transform {written[:40]!r}; expected six numbers, all 0 for none")
    if not any(numbers):
        return None, "", ""
    length, angle = _field(text, "scfgtdu"), _field(text, "scfgtau")
    metres, radians = LENGTH_UNITS.get(length.lower()), ANGLE_UNITS.get(angle.lower())
    if metres is None or radians is None:
        unit, known = (length, LENGTH_UNITS) if metres is None else (angle, ANGLE_UNITS)
        raise ValueError(
            f"its tool transform {written[:60]} has the unit {unit[:20]!r}, expected one of {', '.join(known)}; "
            "set all six numbers to 0 on the sensor's page"
        )
    values = np.array(numbers)
    shown = (
        f"{', '.join(f'{value:g}' for value in numbers[:3])} {length} and {', '.join(f'{v:g}' for v in numbers[3:])} {angle}"
    )
    if KEEP_TRANSFORM in text:
        notice = (
            f"The sensor's box has a tool transform ({shown}), and transform=keep leaves it: the pose of the sensor in the "
            "scene must be that of this frame"
        )
        return None, "in the frame of the box's tool transform", notice
    notice = (
        f"The sensor's box has a tool transform ({shown}); it is undone, so moments are about the sensor's own origin. Set it "
        "to 0 on the box's page, or add transform=keep to the address if the scene's sensor is at the transformed frame"
    )
    matrix = tool_transform_matrix(values[:3] * metres, values[3:] * radians)
    return matrix, "in the sensor's own frame (the box's tool transform is undone)", notice


def _settings_words(text: str) -> str:
    """Name serial number, rate and filter of a page."""
    rate, code = _number(_field(text, "comrdtrate")), _number(_field(text, "setuserfilter"))
    hz = FILTER_HZ_OF_CODE.get(int(code)) if math.isfinite(code) else None
    words = [
        _field(text, "cfgcalsn")[:20],
        f"set to {rate:g} Hz" if 0 < rate < math.inf else "",
        f"low-pass {hz} Hz" if hz else "",
    ]
    return ", ".join(filter(None, words))


def _field(text: str, name: str) -> str:
    # Not an XML parser: a stranger's page may hold entities without end.
    found = re.search(f"<{name}>([^<]{{1,120}})</{name}>", text)
    return found[1].strip() if found else ""


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _numbers(text: str) -> list[float]:
    return [_number(word) for word in re.split(r"[;,\s]+", text.strip()) if word]

"""Imperfections of the simulated robot and rig: each is a size with its source, and 0 switches it off.

Sizes marked "assumed" have no published source; they are plausible for a small arm.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

from skincal.model.errors import InputError


@dataclass(frozen=True, slots=True)
class Effects:
    """Sizes of the imperfections, SI units. The default has all of them."""

    noise: float = 0.25
    """N, sd of one force reading; moments 0.02 m times as much. Resolution of the iCub's FT45 (docs/noise.md)."""
    vibration: float = 0.2
    """N rms that the sensor reads at rest because its mount trembles. A public log of an iCub's sensor: 0.13 to 0.34 N
    (docs/noise.md)."""
    weight: float = 0.883
    """kg, mass of the part on the sensor. Forearm and hand of the public iCub's URDF (icub-models, iCubGazeboV2_5)."""
    friction: float = 0.6
    """Coulomb coefficient at the tip; off, the tip sticks. Assumed, for rubber or plastic on fabric."""
    patch: float = 1.0
    """Radius of the contact patch over that of the circle that the tip cuts into the layer's face, and grows with the force
    (Johnson, Contact Mechanics, 4.3). Off, the force acts on a point."""
    overshoot: float = 0.25
    """Overshoot of the arm's servo over a step. Assumed: damping ratio 0.4 (Astrom and Murray, Feedback Systems, 6.3)."""
    sag: float = 5e-4
    """rad per N m: compliance of each joint, under the load and the arm's weight. A harmonic drive of size 14 has 2e-4
    (CSF-14 catalogue); belts and servo add to it. Assumed."""
    low_pass: float = 50.0
    """Hz, first-order low-pass filter in the sensor; readings are 20 ms late (`SENSOR_DELAY_S`). Assumed."""
    base: float = 0.002
    """m, sd along each axis of the error of the robot's base frame, with 0.25 degrees for each millimetre. Assumed:
    robots know their tip to 1 to 5 mm."""

    scale: float = 0.002
    """sd of the scale of a cobot's lengths: sources as of the next. Only with a sensor on the tool, or without one."""
    warp: float = 0.0005
    """m, rms of a cobot's smooth position error over its workspace; the makers give 0.03 mm for repeats alone, and calibrated
    arms are right to 0.3 to 1 mm (ISO 9283 tests in the literature). Assumed."""
    tcp: float = 0.001
    """m, error of the tool centre point, root of the sum of squares: of a fixed-point test by hand."""
    late: float = 0.02
    """s, delay of the stream of poses: one to five cycles of a controller at 125 Hz."""
    bend: float = 5e-5
    """m per N, how the tool and the arm yield: collaborative arms have 20 to 50 N/mm. Assumed."""
    hand: float = 0.0005
    """m, sd along each axis of the error of a person who guides the tip to a landmark. Assumed: half the slot of a screw."""

    @classmethod
    def none(cls) -> Effects:
        """Return an ideal rig."""
        return cls(**{item.name: 0.0 for item in fields(cls)})

    @classmethod
    def named(cls, text: str) -> Effects:
        """Read `all`, `none`, or names separated by commas. Raises InputError: a name is unknown."""
        if text in ("all", "none"):
            return cls() if text == "all" else cls.none()
        return cls.only(*(name.strip() for name in text.split(",")))

    @classmethod
    def only(cls, *names: str) -> Effects:
        """Switch on the named effects alone. Raises InputError: a name is unknown."""
        sizes = {item.name: item.default for item in fields(cls)}
        for name in names:
            if name not in sizes:
                raise InputError(f"there is no effect {name!r}; expected some of {', '.join(sizes)}.")
        return replace(cls.none(), **{name: sizes[name] for name in names})


TOOL_EFFECTS = ("scale", "warp", "tcp", "late", "bend", "hand")
"""Effects of a cobot whose poses are streamed: a sensor on the tool, or none. `sag` is in `bend` there."""
EFFECT_NAMES = tuple(item.name for item in fields(Effects))
SENSOR_DELAY_S = 0.020
"""s, delay of a filtered sensor's readings."""
BASE_TURN_PER_M = 0.25 * 3.141592653589793 / 180 / 0.001
"""rad of rotation error of the base frame for each metre of position error."""
FRICTION_COEFFICIENT_WITHOUT_SLIP = 10.0
"""Coulomb coefficient of a tip that does not slip."""

"""What the guide wants and what it takes for granted; each number with its unit and its reason."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class GuideSettings:
    """SI units."""

    wanted: float = 0.003
    """m, predicted rms error at which a taxel may be done: a little over half of the 5 mm between taxels."""
    module_pokes: int = 4
    """Pokes of a module's own, by the modules method: four places tell where it lies and how it is turned, and one is spare."""
    own_pokes: int = 3
    """Pokes of its own, in which the taxel answers most: what neighbours' pokes say of it is off to their side."""
    diversity: float = float(np.radians(15.0))
    """rad, free method: below it depth is four times worse than the place across (1/sin)."""
    balance: float = 0.001
    """m: the middle of a taxel's contacts may lie this far beside it. Beyond, its estimate is pulled there."""
    settled: float = 0.0005
    """m: how far the last poke of its own may have moved a taxel."""
    usable_tilt: float = float(np.radians(28.0))
    """rad, from the normal: a little less than the friction of a tip on foam holds."""
    tolerance: float = float(np.radians(10.0))
    """rad: a push within this of the wanted one is as asked; the hand's own error is 6 degrees (sd)."""
    sweep: float = 1.5
    """Pokes a taxel until the guide asks for pokes of its own: until then those between taxels tell more, afterwards they
    pull neighbours together."""
    unanswered: int = 3
    """A taxel that was poked at so often and never answered is given up: it may be broken, or not where the layout says."""
    patience: int = 15
    """Own pokes after which a taxel is given up that is not done: twice as many as one needs in the mean."""
    unknown: float = 0.020
    """m, sd of a taxel's place in each direction before anything is known: keeps one axis finite; never counts as known."""
    poke_s: float = 2.0
    """s, for a poke where the hand is: measured on the simulated operator, whose habits are assumed."""
    hand_speed: float = 0.15
    """m/s, of the hand between taxels. Assumed: slow, as one aims."""

"""What somebody who looks at the window pokes: told to a simulated operator."""

from __future__ import annotations

from app.running import Running
from skincal.guide.guidance import Guidance
from skincal.simulate.orders import NoTarget, TargetOrder, Wish


def wish_of(guidance: Guidance | None, running: Running) -> Wish:
    """Return what is shown to the operator.

    Parameters
    ----------
    guidance : None where nobody guides
    """
    if running is not Running.STREAMING:
        return NoTarget.WAIT
    if guidance is None:
        return NoTarget.ANY
    target = guidance.target
    if target is None:
        return NoTarget.WAIT
    return TargetOrder(target.channel, target.place, target.push, known=bool(target.landmark))

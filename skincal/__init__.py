"""Where every taxel of a robot skin is, from pokes measured by a force/torque sensor.

The core: no window, no drawing. See `docs/conventions.md` for frames, units and terms.
"""

__version__ = "0.1.0"

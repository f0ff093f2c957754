"""Where every taxel of a robot skin is, from pokes measured by a force/torque sensor.

The core: no window, no drawing. See `docs/conventions.md` for frames, units and terms.

Linear algebra runs in one thread, in this process and those it starts, unless the environment says otherwise or numpy was
imported before: the matrices are small, and beside a busy process threads that wait for one another take ten times as long.
"""

import os

__version__ = "0.1.0"

# OpenBLAS, MKL and Accelerate read these once, when numpy or scipy is imported.
for _variable in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
    os.environ.setdefault(_variable, "1")

"""Run all checks of a checkout, on a machine that has nothing but Python: `python3 check.py`.

Installs the packages of the tests, then runs the style, type and layer checks and the tests. With arguments, only pytest
runs: `python3 check.py tests/skincal -k clock`.
"""

import os
import sys

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))  # noqa: PTH100, PTH120 - missing where PYTHONSAFEPATH is set
from tools.checkout import require_python

if __name__ == "__main__":
    require_python()
    from tools import launch  # an older Python could not read it

    sys.exit(launch.run(launch.check))

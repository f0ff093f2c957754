"""Open skincal from a checkout, on a machine that has nothing but Python: `python3 start.py`.

Installs what is missing, then opens the window on a simulated forearm that is being poked; where there is no display it runs
the same session without a window. Any skincal command works the same way: `python3 start.py solve SESSION`.
"""

import os
import sys

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))  # noqa: PTH100, PTH120 - missing where PYTHONSAFEPATH is set
from tools.checkout import require_python


def main() -> int:
    """Prepare the environment and become skincal."""
    require_python()
    from tools import launch  # an older Python could not read it

    return launch.start(sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())

"""`python -m skincal.cli`: the commands without the window."""

import sys

from skincal.cli import main

sys.exit(main())

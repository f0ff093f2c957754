"""Colours of window, figures and reports: those of Okabe and Ito (2008), which people with any colour vision can distinguish.

A method has one hue in all drawings: that of `METHODS` on white, a lighter one (`METHODS_ON_DARK`) on a dark ground. Lines on
white have a contrast of 3:1 at least, which excludes sky, orange and yellow, and needs a darker green.
"""

from __future__ import annotations

BLACK, ORANGE, SKY, GREEN, YELLOW = "#000000", "#E69F00", "#56B4E9", "#009E73", "#F0E442"
BLUE, VERMILION, PINK = "#0072B2", "#D55E00", "#CC79A7"

METHODS = {"free": BLUE, "surface": VERMILION, "modules": "#00795A"}
"""By the method's name in files, on white."""
METHODS_ON_DARK = {"free": SKY, "surface": ORANGE, "modules": "#35C596"}
"""The same on a dark ground."""

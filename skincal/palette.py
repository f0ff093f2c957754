"""The hues of window, figures and reports: those of Okabe and Ito (2008), which people with any colour vision tell apart.

A method has one hue wherever it is drawn; upon white that of `METHODS`, upon a dark ground a lighter one of the same name
(`METHODS_ON_DARK`). Lines upon white keep 3:1, which sky, orange and yellow would not, nor green upon the window's grey: that
is darker than theirs.
"""

from __future__ import annotations

BLACK, ORANGE, SKY, GREEN, YELLOW = "#000000", "#E69F00", "#56B4E9", "#009E73", "#F0E442"
BLUE, VERMILION, PINK = "#0072B2", "#D55E00", "#CC79A7"

METHODS = {"free": BLUE, "surface": VERMILION, "modules": "#00795A"}
"""By the method's name in files, upon white."""
METHODS_ON_DARK = {"free": SKY, "surface": ORANGE, "modules": "#35C596"}
"""The same upon a dark ground."""

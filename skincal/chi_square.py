"""Medians of chi-square: the spread of misses follows from their median."""

CHI2_1DOF_MEDIAN, CHI2_2DOF_MEDIAN = 0.4549, 1.3863
"""Of one and of two degrees of freedom."""

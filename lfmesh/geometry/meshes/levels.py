"""The levels of `surface`: what a facet stands for, by name and as the kernels' numbers."""

FLAT, SMOOTH, PATCH, EXACT = 0, 1, 2, 3

SURFACE_LEVEL = {"flat": FLAT, "smooth": SMOOTH, "patch": PATCH, "exact": EXACT}

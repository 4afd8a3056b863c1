"""The levels of `surface`, by name and by the kernels' numbers: the shape that a facet stands for."""

FLAT, SMOOTH, PATCH, EXACT = 0, 1, 2, 3

SURFACE_LEVEL = {"flat": FLAT, "smooth": SMOOTH, "patch": PATCH, "exact": EXACT}

"""A scene as kernels read it: tables of lens, array, objects and frames."""

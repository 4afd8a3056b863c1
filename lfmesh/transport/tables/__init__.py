"""Tables of a scene as kernels read them: lens, array, objects and frames."""

"""Tables of a scene for kernels: lens, array, objects and frames."""

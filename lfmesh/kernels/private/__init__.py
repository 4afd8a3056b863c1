"""Code on numba's private classes that shortens the first render of a fresh install; see `accelerator`."""

"""Numba's private classes, which shorten the first render of a fresh install, behind the probe of `accelerator`."""

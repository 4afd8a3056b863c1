"""Compilation of kernels: decorators, their cache on disk, tables passed by address, vector operations and search."""

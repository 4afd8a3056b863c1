"""Compiling and nothing else: decorators of kernels, their cache, tables passed by address, operations and search."""

"""Shapes: exact surfaces, their meshes, the lattice of the array, mesh files and rigid frames."""

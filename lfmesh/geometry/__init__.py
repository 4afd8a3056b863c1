"""Shapes: exact surfaces, their meshes, the microlens lattice, mesh files and rigid frames."""

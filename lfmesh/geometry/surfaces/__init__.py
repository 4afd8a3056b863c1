"""Exact surfaces: sag, normal, crossing, meshes of them, and surfaces recognised in meshes."""

"""Meshes from files: of triangles, of CAD systems, glTF."""

"""Meshes from files: triangle meshes, CAD solids, glTF."""

"""Targets and bodies of glass: their meshes, exact round faces, pictures and places."""

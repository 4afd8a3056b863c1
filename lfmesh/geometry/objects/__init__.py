"""Targets and bodies of glass as meshes, their pictures and places."""

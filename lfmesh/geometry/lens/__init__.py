"""The main lens as meshes."""

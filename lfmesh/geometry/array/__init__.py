"""The microlens array: its lattice and the shapes of its lenslets."""

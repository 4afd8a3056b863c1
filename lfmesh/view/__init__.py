"""Visualisation: rays launched, tabulated and drawn, and the scene in 3D."""

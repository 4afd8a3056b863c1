"""Rays made visible: launched, tabled and drawn, and the scene in 3D."""

"""Seeing what rays do: launching them, their paths in tables and pictures, the scene in 3D."""

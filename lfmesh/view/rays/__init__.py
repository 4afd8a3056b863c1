"""Rays to look at: launching, recording, filtering, tables and ghosts."""

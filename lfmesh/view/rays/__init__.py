"""Rays for inspection: launching, recording, filtering, tables and ghosts."""

"""Checks of a run, and warnings where a picture is or may be wrong."""

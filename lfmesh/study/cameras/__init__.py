"""Comparison of camera types."""

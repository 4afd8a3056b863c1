"""Kinds of camera side by side."""

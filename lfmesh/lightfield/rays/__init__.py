"""Rays in object space that pixels and views see."""

"""Photographs and depth from a light field."""

"""Datasets of scenes drawn from one template."""

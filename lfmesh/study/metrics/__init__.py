"""Metrics of a camera against a reference, and their pictures."""

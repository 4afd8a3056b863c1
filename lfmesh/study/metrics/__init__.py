"""Metrics of a camera against a reference, and the pictures that they are made of."""

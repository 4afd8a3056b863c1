"""Errors of cameras: ready-made studies, largest changes that keep limits, adjustments, and budgets."""

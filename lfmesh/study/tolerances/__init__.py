"""Camera errors: ready-made studies, largest changes within limits, adjustments, and budgets."""

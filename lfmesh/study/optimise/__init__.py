"""Camera optimisation: design files, merit, derivatives of rays, search, report."""

"""Numbers of a camera brought to their best: design files, merit, derivatives of rays, search, report."""

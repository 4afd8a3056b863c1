"""Lens-sheet analysis of the main lens: spots, ray fans, field curvature, colour, illumination, MTF."""

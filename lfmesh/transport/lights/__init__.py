"""Lights that a point asks. Each draws a ray to itself, with its density, and is combined with scattered rays."""

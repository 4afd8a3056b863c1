"""Aims: where rays are sent to, each with a draw, a density, and a support that rays from the stop prove."""

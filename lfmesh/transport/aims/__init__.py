"""Aims: targets of sampled rays, with draw, density, and a support proved by rays from the stop."""

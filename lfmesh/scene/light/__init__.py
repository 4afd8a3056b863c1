"""Lamps, particles, and the spectra of light."""

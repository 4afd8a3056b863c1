"""Regions of travel: lens, array, objects and sensor, and the queries of Embree."""

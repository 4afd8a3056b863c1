"""Regions in which packets travel: lens, array, objects and sensor, and the queries of Embree."""

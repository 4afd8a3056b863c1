"""Where it happens: lens, array, objects and sensor, and asking Embree."""

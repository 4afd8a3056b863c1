"""Cases made to break a ray tracer, by subject; see `lfmesh.accuracy.hard_cases`."""

"""Cases made to break a ray tracer, by subject; `lfmesh.accuracy.hard_cases` lists and runs them."""

"""Cases made to break a ray tracer, by subject; `lfmesh.study.hard_cases` lists and runs them."""

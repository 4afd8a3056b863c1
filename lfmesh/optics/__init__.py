"""The physics of single events: Fresnel's equations, coatings, glass, scattering; independent of geometry."""

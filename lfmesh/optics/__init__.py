"""The physics of one event: Fresnel's equations, coatings, glass, scattering. Knows no geometry."""

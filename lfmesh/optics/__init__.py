"""The physics of one event: Fresnel's equations, glass, scattering. Knows no geometry."""

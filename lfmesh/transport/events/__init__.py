"""Events of a packet: crossings of interfaces, scattering, lighting, travel."""

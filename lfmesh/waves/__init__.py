"""Waves: optical path lengths of traced rays, wavefronts and diffraction."""

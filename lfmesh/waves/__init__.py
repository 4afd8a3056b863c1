"""Waves: optical path lengths along traced rays, wavefronts and what diffraction makes of them."""

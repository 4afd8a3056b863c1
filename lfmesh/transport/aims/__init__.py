"""Pupils, lenslet views and the aim: where rays are sent, and the proof that nothing is missed."""

"""Rays through a built scene: random numbers, Embree, the engine, both methods, the ledger."""

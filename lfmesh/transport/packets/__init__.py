"""The packet, its registries, the ledger, and random numbers."""

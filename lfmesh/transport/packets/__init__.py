"""The packet, its registries, its classes, the ledger, and random numbers."""

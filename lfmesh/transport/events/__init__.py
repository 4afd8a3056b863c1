"""What can happen to a packet."""

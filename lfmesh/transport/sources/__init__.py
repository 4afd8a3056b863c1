"""What starts packets: pixels, lights and targets that shine, rays that are given."""

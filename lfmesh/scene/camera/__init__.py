"""The camera: lens, microlens array, cover, sensor, and the surfaces that they are made of."""

"""The camera: lens, microlens array, cover and sensor, with the surfaces of each."""

"""Light fields: white image, calibration, decoding, views, refocusing and depth."""

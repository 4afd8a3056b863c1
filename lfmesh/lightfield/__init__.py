"""What a raw image means: white image, true geometry, decoding, refocusing."""

"""What a run proves of itself, and what it says where a picture is or may be wrong."""

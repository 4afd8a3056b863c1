"""What a path is: its states and classes, and the estimators that share out the classes of an image."""

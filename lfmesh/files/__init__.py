"""Runs on disk: raw images, previews and reports. Only this package knows OpenEXR."""

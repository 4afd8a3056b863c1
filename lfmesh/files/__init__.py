"""Run folders: raw images, previews and reports. Only this package imports OpenEXR."""

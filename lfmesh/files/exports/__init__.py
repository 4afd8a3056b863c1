"""Light fields and raw images in the files of other people's tools."""

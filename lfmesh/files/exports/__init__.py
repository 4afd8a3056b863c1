"""Export of light fields and raw images to the file formats of other tools."""

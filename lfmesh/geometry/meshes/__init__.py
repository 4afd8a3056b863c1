"""Triangle meshes: facets, curved patches, normals, point-in-body tests."""

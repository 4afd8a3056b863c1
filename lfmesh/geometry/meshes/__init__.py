"""Triangle meshes: facets, curved patches, normals, inside and outside."""

"""Files of other programs: lens files of optical design programs, read and written, and scenes as glTF files.

Importing this package registers its lens readers with the scene (`lfmesh.scene.camera.lens_readers`), so that
`camera.lens = { file = "x.zmx" }` works, and its reader of glTF scenes (`lfmesh.scene.objects.gltf_reader`).
"""

from lfmesh.imports.gltf_scene import GltfScene, read_gltf, with_gltf
from lfmesh.imports.lens_file import READERS, read_lens, read_lens_file, write_lens_file
from lfmesh.scene.camera.lens_readers import register
from lfmesh.scene.objects import gltf_reader

__all__ = ["GltfScene", "read_gltf", "read_lens", "read_lens_file", "with_gltf", "write_lens_file"]

for _ending in READERS:
    register(_ending, read_lens)
gltf_reader.register(with_gltf)

"""Other people's files: lens files of other design programs, read and written, and scenes as glTF files.

Importing this part registers its readers in the scene's table (`lfmesh.scene.camera.lens_readers`), so that
`camera.lens = { file = "x.zmx" }` works without the scene knowing of them, and that of glTF scenes
(`lfmesh.scene.objects.gltf_reader`).
"""

from lfmesh.imports.gltf_scene import GltfScene, read_gltf, with_gltf
from lfmesh.imports.lens_file import READERS, read_lens, read_lens_file, write_lens_file
from lfmesh.scene.camera.lens_readers import register
from lfmesh.scene.objects import gltf_reader

__all__ = ["GltfScene", "read_gltf", "read_lens", "read_lens_file", "with_gltf", "write_lens_file"]

for _ending in READERS:
    register(_ending, read_lens)
gltf_reader.register(with_gltf)

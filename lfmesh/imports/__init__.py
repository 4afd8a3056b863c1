"""Other people's files: lens files of other design programs, read into this program's lens and written from it.

Importing this part registers its readers in the scene's table (`lfmesh.scene.lens_readers`), so that `camera.lens = {
file = "x.zmx" }` works without the scene knowing of them.
"""

from lfmesh.imports.lens_file import read_lens, read_lens_file, write_lens_file
from lfmesh.scene.lens_readers import register

__all__ = ["read_lens", "read_lens_file", "write_lens_file"]

for _ending in (".zmx", ".seq"):
    register(_ending, read_lens)

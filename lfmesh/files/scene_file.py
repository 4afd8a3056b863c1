"""Scene files, written so that they load from their own folder."""

from pathlib import Path

from lfmesh.errors import FileError
from lfmesh.files.inputs import within
from lfmesh.files.whole import write_whole
from lfmesh.scene import Scene

ENDING = ".toml"


def save_scene(scene: Scene, path: Path) -> Path:
    """Write a scene file; see `lfmesh.files.run.save`."""
    if path.suffix.lower() != ENDING:
        raise FileError(f"{path}: a scene file must end in {ENDING}")
    write_whole(path, within(scene, path.parent).dump_toml())
    return path

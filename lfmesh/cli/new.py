"""A scene to start from: `lfmesh new`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from lfmesh.cli.application import app
from lfmesh.errors import FileError, LfmeshError
from lfmesh.wrapping import wrapped


@app.command(
    help_epilogue="""\
More examples:

    lfmesh new --list
    lfmesh new part.toml --camera raytrix_r12 --target part.stl
    lfmesh new piv.toml --camera auburn_piv --lens lib:double_gauss_50mm
"""
)
def new(
    scene: Annotated[Path | None, Parameter(name="scene", help="Scene file to write.")] = None,
    /,
    *,
    camera: Annotated[str | None, Parameter(help="Camera of the library.")] = None,
    lens: Annotated[
        str | None, Parameter(help='Lens file, or "lib:" and a name, in place of the camera\'s lens.')
    ] = None,
    target: Annotated[Path | None, Parameter(help="Mesh file, in place of the objects in front of the camera.")] = None,
    listed: Annotated[bool, Parameter(name="--list", help="List the cameras and their sources.")] = False,
) -> int:
    """Write a commented scene with a published camera, to start from.

    Comments name the source of its figures, and tell published figures from assumed ones.
    """
    from lfmesh.scene.camera_library import camera_names, cameras_in_words, library_camera

    if listed:
        for name in camera_names():
            print(wrapped(str(library_camera(name))))
        return 0
    if camera is None:
        raise LfmeshError(f"--camera: missing; {cameras_in_words()}")
    if scene is None:
        raise LfmeshError("scene: missing; give the scene file to write, such as scene.toml")
    if scene.exists():
        raise FileError(f"{scene} is there already: move it, or give another name")
    from lfmesh.files.whole import write_whole
    from lfmesh.scene.new_scene import new_scene

    write_whole(scene, new_scene(camera, scene.parent, lens=lens, target=target))
    print(f"  {scene}\n" + wrapped(f"lfmesh check {scene} prints its first-order optics."))
    return 0

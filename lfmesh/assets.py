"""Paths of the scenes, lenses, meshes and charts that come with lfmesh."""

from pathlib import Path

from lfmesh.errors import FileError


def asset_path(name: str) -> Path:
    """Return the path of a file or folder that comes with lfmesh.

    Parameters
    ----------
    name : str
        Path relative to the assets, such as ``"scenes/first_light.toml"``.

    Returns
    -------
    Path

    Raises
    ------
    FileError
        There is no such asset; the message lists its neighbours.
    """
    package = Path(__file__).resolve().parent
    # An installed wheel has the assets inside the package, a checkout beside it.
    folders = [package / "assets", package.parent / "assets"]
    for folder in folders:
        if (folder / name).exists():
            return folder / name
    neighbours = sorted(
        {
            path.relative_to(folder).as_posix()
            for folder in folders
            for path in (folder / name).parent.glob("*")
            if not path.name.startswith(".")
        }
    )
    valid = ", ".join(neighbours) if neighbours else "none: the installation is incomplete"
    raise FileError(f"asset {name!r} does not exist; there are: {valid}")

"""3MF files: a ZIP archive with the model as XML (3MF Core Specification 1.3)."""

import zipfile
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from lfmesh.errors import MeshError
from lfmesh.geometry.frame import compose
from lfmesh.geometry.mesh import Array, Mesh

UNITS = {
    "micron": "um",
    "millimeter": "mm",
    "centimeter": "cm",
    "meter": "m",
    "inch": "inch",
    "foot": "foot",
}

_CORE = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"
_RELATION = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
_MAX_DEPTH = 32


def read_3mf(path: Path) -> tuple[list[Mesh], str]:
    """Return the meshes that a 3MF file builds, transforms applied, in its unit, and the name of that unit.

    Raises
    ------
    MeshError
        The file is no 3MF, or its model is broken.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            model = ElementTree.fromstring(archive.read(_model_name(archive)))
        unit = UNITS[model.get("unit", "millimeter")]
        objects = {part.attrib["id"]: part for part in model.iter(f"{_CORE}object")}
        return [
            mesh
            for item in model.iterfind(f"{_CORE}build/{_CORE}item")
            for mesh in _meshes(objects, item.attrib["objectid"], _transform(item), 0)
        ], unit
    except (OSError, zipfile.BadZipFile, ElementTree.ParseError, LookupError, ValueError) as error:
        reason = f"{type(error).__name__}: {error}".splitlines()[0]
        raise MeshError(f"{path}: broken, or not a 3MF file ({reason})") from None


def _model_name(archive: zipfile.ZipFile) -> str:
    """Return the archive member that holds the model, as the package's relationships name it."""
    for relation in ElementTree.fromstring(archive.read("_rels/.rels")):
        if relation.get("Type") == _RELATION:
            return relation.attrib["Target"].lstrip("/")
    raise LookupError("the package names no 3D model")


def _meshes(objects: dict[str, ElementTree.Element], name: str, transform: Array, depth: int) -> Iterator[Mesh]:
    """Yield the meshes of an object and of the components it is put together from."""
    if depth > _MAX_DEPTH:
        raise ValueError("components contain one another")
    part = objects[name]
    for mesh in part.iterfind(f"{_CORE}mesh"):
        corners = [[float(v.attrib[axis]) for axis in "xyz"] for v in mesh.iter(f"{_CORE}vertex")]
        faces = [[int(t.attrib[v]) for v in ("v1", "v2", "v3")] for t in mesh.iter(f"{_CORE}triangle")]
        vertices, facets = np.array(corners).reshape(-1, 3), np.array(faces, dtype=np.int64).reshape(-1, 3)
        if len(facets) and not 0 <= facets.min() <= facets.max() < len(vertices):
            raise ValueError(f"a triangle names vertex {facets.max()}; there are {len(vertices)}")
        yield Mesh(vertices, facets).moved(transform)
    for component in part.iterfind(f"{_CORE}components/{_CORE}component"):
        inner = _transform(component)
        yield from _meshes(objects, component.attrib["objectid"], compose(transform, inner), depth + 1)


def _transform(element: ElementTree.Element) -> Array:
    """Return the (3, 4) transform of an element; the file holds it row by row for row vectors."""
    numbers = element.get("transform")
    if numbers is None:
        return np.eye(3, 4)
    return np.array([float(number) for number in numbers.split()]).reshape(4, 3).T

"""Scene with rays as a glTF model, in metres, for other viewers."""

from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pyvista as pv
import trimesh
from trimesh.path.entities import Line
from trimesh.visual.material import PBRMaterial

from lfmesh.files.whole import write_whole
from lfmesh.geometry.objects.texture import srgb_to_linear
from lfmesh.view.scene3d.parts import Part
from lfmesh.view.scene3d.plotter import View

METRES = 1e-3
"""Metres per millimetre."""

RAYS = "rays"


def write_model(view: View, path: Path) -> None:
    """Write the content of a view as a binary glTF file.

    Bodies have the names of `World.mesh_names`; rays are lines.
    """
    scene = trimesh.Scene()
    for part, mesh in view.meshes():
        if mesh.n_cells and not mesh.n_lines:
            scene.add_geometry(_body(part, mesh.triangulate()), geom_name=part.label, node_name=part.label)
    if view.lines is not None and len(view.lines):
        scene.add_geometry(_rays(view), geom_name=RAYS, node_name=RAYS)
    write_whole(path, scene.export(file_type="glb", include_normals=True))


def _body(part: Part, mesh: pv.PolyData) -> trimesh.Trimesh:
    *coded, opacity = pv.Color(part.look.get("color", "white"), opacity=float(part.look.get("opacity", 1.0))).float_rgba
    see_through = opacity < 1.0 or (part.picture is not None and part.picture.shape[2] == 4)
    material: dict[str, Any] = {
        "name": part.label,
        # glTF's factors are linear light.
        "baseColorFactor": [*srgb_to_linear(np.array(coded)).tolist(), opacity],
        "metallicFactor": 0.0,
        "roughnessFactor": 0.3,
        "doubleSided": True,
        "alphaMode": "BLEND" if see_through else "OPAQUE",
    }
    uv = mesh.active_texture_coordinates
    if part.picture is not None and uv is not None:
        material["baseColorTexture"] = PIL.Image.fromarray(np.ascontiguousarray(part.picture))
    body = trimesh.Trimesh(METRES * np.asarray(mesh.points), mesh.regular_faces, process=False)
    body.visual = trimesh.visual.TextureVisuals(
        uv=np.asarray(uv) if uv is not None else np.zeros((len(body.vertices), 2)), material=PBRMaterial(**material)
    )
    return body


def _rays(view: View) -> trimesh.path.Path3D:
    assert view.lines is not None
    assert view.ray_mesh is not None
    points, firsts = view.lines.points
    rgb = np.asarray(view.ray_mesh.cell_data["rgba"])[:, :3]
    lines = [
        Line(np.arange(first, end), color=[*colour, 255])
        for first, end, colour in zip(firsts, firsts[1:], rgb, strict=False)
    ]
    return trimesh.path.Path3D(entities=lines, vertices=METRES * points, process=False)

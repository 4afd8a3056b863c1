"""Scenes: the models of a scene file, reading and writing it, and its first-order optics."""

from lfmesh.scene.back_face import BackFace
from lfmesh.scene.camera import Camera
from lfmesh.scene.coatings import Coating, Layer
from lfmesh.scene.files import load, load_lens, loads
from lfmesh.scene.finishes import Finish
from lfmesh.scene.lens import Element, Lens, Surface
from lfmesh.scene.lights import (
    CircularPolarisation,
    DirectionalLight,
    DiskLight,
    Light,
    LinearPolarisation,
    PointLight,
    SpotLight,
)
from lfmesh.scene.media import Grid, Medium
from lfmesh.scene.mla import ArrayForm, MicrolensArray
from lfmesh.scene.paraxial import Paraxial
from lfmesh.scene.pose import Pose
from lfmesh.scene.refractor import MeshFace, MeshShape, Refractor
from lfmesh.scene.report import FirstOrder, first_order
from lfmesh.scene.scene import Scene
from lfmesh.scene.sensor import Sensor
from lfmesh.scene.solve import solved
from lfmesh.scene.tank import Liquid, Tank, Wall
from lfmesh.scene.targets import Box, Cylinder, Disk, Gloss, Material, Plane, Shape, Sphere, Target
from lfmesh.scene.transport import Tessellation, Transport

__all__ = [
    "ArrayForm",
    "BackFace",
    "Box",
    "Camera",
    "CircularPolarisation",
    "Coating",
    "Cylinder",
    "DirectionalLight",
    "Disk",
    "DiskLight",
    "Element",
    "Finish",
    "FirstOrder",
    "Gloss",
    "Grid",
    "Layer",
    "Lens",
    "Light",
    "LinearPolarisation",
    "Liquid",
    "Material",
    "Medium",
    "MeshFace",
    "MeshShape",
    "MicrolensArray",
    "Paraxial",
    "Plane",
    "PointLight",
    "Pose",
    "Refractor",
    "Scene",
    "Sensor",
    "Shape",
    "Sphere",
    "SpotLight",
    "Surface",
    "Tank",
    "Target",
    "Tessellation",
    "Transport",
    "Wall",
    "first_order",
    "load",
    "load_lens",
    "loads",
    "solved",
]

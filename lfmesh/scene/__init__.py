"""Scenes: the models of a scene file, reading and writing it, and its first-order optics."""

from lfmesh.scene.camera.back_face import BackFace
from lfmesh.scene.camera.camera import Camera
from lfmesh.scene.camera.element import Element
from lfmesh.scene.camera.lens import Lens
from lfmesh.scene.camera.mla import ArrayForm, MicrolensArray
from lfmesh.scene.camera.sensor import Sensor
from lfmesh.scene.camera.surface import Surface
from lfmesh.scene.files import load, load_lens, loads
from lfmesh.scene.first_order.compute import first_order
from lfmesh.scene.first_order.paraxial import Paraxial
from lfmesh.scene.first_order.report import FirstOrder
from lfmesh.scene.first_order.solve import solved
from lfmesh.scene.light.lights import (
    CircularPolarisation,
    DirectionalLight,
    DiskLight,
    Light,
    LinearPolarisation,
    LineLight,
    PointLight,
    RectangleLight,
    SpotLight,
)
from lfmesh.scene.materials.coatings import Coating, Layer
from lfmesh.scene.materials.finishes import Finish
from lfmesh.scene.materials.matter import Matter
from lfmesh.scene.media.media import Grid, Medium
from lfmesh.scene.motion import Exposure, Motion, TimedPose
from lfmesh.scene.objects.refractor import MeshFace, MeshShape, Refractor
from lfmesh.scene.objects.shapes import Box, Cylinder, Disk, Plane, Shape, Sphere
from lfmesh.scene.objects.tank import Liquid, Tank, Wall
from lfmesh.scene.objects.targets import Gloss, Material, Target
from lfmesh.scene.pose import Pose
from lfmesh.scene.scene import Scene
from lfmesh.scene.settings.transport import Tessellation, Transport

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
    "Exposure",
    "Finish",
    "FirstOrder",
    "Gloss",
    "Grid",
    "Layer",
    "Lens",
    "Light",
    "LineLight",
    "LinearPolarisation",
    "Liquid",
    "Material",
    "Matter",
    "Medium",
    "MeshFace",
    "MeshShape",
    "MicrolensArray",
    "Motion",
    "Paraxial",
    "Plane",
    "PointLight",
    "Pose",
    "RectangleLight",
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
    "TimedPose",
    "Transport",
    "Wall",
    "first_order",
    "load",
    "load_lens",
    "loads",
    "solved",
]

r"""Physical simulation of light-field cameras through triangle-mesh lenses.

    import lfmesh as lf

    scene = lf.load("scene.toml")
    print("\n".join(lf.first_order(scene).lines()))
    image = lf.render(scene)
    lf.save(image, "run/")
    field = lf.decode(image)
    photograph = lf.refocus(field, distance_mm=480.0)

Names are imported when first used, so that ``import lfmesh`` does not wait for numba, Embree or OpenEXR.
"""

from functools import partial
from importlib import import_module
from inspect import isfunction
from typing import TYPE_CHECKING, Any

from lfmesh.arguments import with_checked_arguments
from lfmesh.notebook import show_by

if TYPE_CHECKING:
    from lfmesh.analysis.analysis import LensAnalysis, analyse
    from lfmesh.assets import asset_path
    from lfmesh.errors import (
        BlackPictureWarning,
        BlindCheckWarning,
        ClearAirWarning,
        ClosedGapWarning,
        CoarseFieldWarning,
        CutBodiesWarning,
        CutPathsWarning,
        DiffractionWarning,
        FileError,
        FineVoxelsWarning,
        FoldedPatchesWarning,
        GlassError,
        HeavyPathsWarning,
        HiddenSceneWarning,
        InterruptedRenderWarning,
        LfmeshError,
        LightOutsideAimWarning,
        LostEnergyWarning,
        MeshError,
        MissedLightWarning,
        OpenLedgerWarning,
        OrderCheckWarning,
        PictureWarning,
        SceneError,
        TooFewSamplesWarning,
        UnknownErrorWarning,
    )
    from lfmesh.files.camera_model import write_camera_model
    from lfmesh.files.exports.export import export_field, export_raw
    from lfmesh.files.matrix import open_projection_matrix, write_projection_matrix
    from lfmesh.files.run import open_run, open_white, save, save_white
    from lfmesh.geometry.lens.solved_camera import first_order
    from lfmesh.lightfield.calibration.calibration import Calibration, calibrate
    from lfmesh.lightfield.calibration.centres import estimate_centres
    from lfmesh.lightfield.calibration.white import white_image
    from lfmesh.lightfield.detector import Detector, Exposed
    from lfmesh.lightfield.photographs.depth import DepthMap, estimate_depth
    from lfmesh.lightfield.photographs.depth_truth import DepthTruth, depth_truth
    from lfmesh.lightfield.photographs.photograph import AllInFocus, FocalStack, Photograph, all_in_focus
    from lfmesh.lightfield.photographs.refocus import focal_stack, refocus
    from lfmesh.lightfield.photographs.schlieren import Schlieren, schlieren
    from lfmesh.lightfield.rays.camera_model import CameraModel, camera_model
    from lfmesh.lightfield.rays.object_rays import object_rays
    from lfmesh.lightfield.rays.ray_model import RayModel
    from lfmesh.lightfield.views.decode import decode
    from lfmesh.lightfield.views.field import LightField
    from lfmesh.lightfield.views.focused import focused
    from lfmesh.lightfield.views.patches import patches_in_focus, render_patches
    from lfmesh.lightfield.volumes.projection import projection_matrix
    from lfmesh.lightfield.volumes.projection_matrix import ProjectionMatrix
    from lfmesh.lightfield.volumes.reconstruction import Reconstruction, reconstruct, volume_quality
    from lfmesh.lightfield.volumes.voxel_box import VoxelBox
    from lfmesh.scene import (
        ArrayForm,
        BackFace,
        Box,
        Camera,
        Cylinder,
        DirectionalLight,
        Disk,
        DiskLight,
        FirstOrder,
        Gloss,
        Lens,
        LineLight,
        Liquid,
        Material,
        Matter,
        MicrolensArray,
        Plane,
        PointLight,
        Pose,
        RectangleLight,
        Refractor,
        Scene,
        Sensor,
        Sphere,
        SpotLight,
        Surface,
        Tank,
        Target,
        Tessellation,
        Transport,
        Wall,
        load,
        loads,
        solved,
    )
    from lfmesh.scene.camera.bands import Band
    from lfmesh.scene.camera.cover import Cover
    from lfmesh.scene.camera.gradient import (
        AxialGradient,
        GradientDispersion,
        GradiumGradient,
        RadialGradient,
        RadialSquareGradient,
        SelfocGradient,
        SphericalGradient,
        XyzGradient,
    )
    from lfmesh.scene.camera.lens import Element
    from lfmesh.scene.camera.outer_zone import OuterZone
    from lfmesh.scene.camera.phase import (
        GratingPhase,
        GridPhase,
        HologramPhase,
        MetalensPhase,
        Order,
        PhaseZone,
        RadialPhase,
        XyPhase,
        ZonedPhase,
    )
    from lfmesh.scene.camera.qbfs import Qbfs
    from lfmesh.scene.camera.qcon import Qcon
    from lfmesh.scene.camera.sections import Biconic, Toroid
    from lfmesh.scene.light.lights import CircularPolarisation, LinearPolarisation
    from lfmesh.scene.light.particles import (
        MeasuredDisplacement,
        Particles,
        RotationDisplacement,
        Sheet,
        UniformDisplacement,
        VortexDisplacement,
    )
    from lfmesh.scene.light.spectra import Spectrum
    from lfmesh.scene.materials.coatings import Coating, Layer, MeasuredIndex, MeasuredReflectance
    from lfmesh.scene.materials.finishes import Finish
    from lfmesh.scene.materials.own_glass import OwnGlass
    from lfmesh.scene.media.air import Air
    from lfmesh.scene.media.media import Grid, Medium, MeshBounds
    from lfmesh.scene.media.phase import HenyeyGreensteinPhase, IsotropicPhase, MiePhase, RayleighPhase, TabulatedPhase
    from lfmesh.scene.motion import Exposure, Motion, TimedPose
    from lfmesh.scene.objects.refractor import MeshFace
    from lfmesh.scene.particle_frames import displaced, particle_vectors
    from lfmesh.study.datasets.dataset import Dataset
    from lfmesh.study.fits.board_corners import BoardCorners
    from lfmesh.study.fits.board_fit import BoardFit, fit_boards
    from lfmesh.study.fits.board_pictures import Board
    from lfmesh.study.fits.fit import Fit, fit
    from lfmesh.study.optimise.optimise import Optimum, optimise
    from lfmesh.study.sweeps.study import Study
    from lfmesh.transport.build import build
    from lfmesh.transport.packets.ledger import Ledger
    from lfmesh.transport.packets.packet import Event
    from lfmesh.transport.render.image import Image
    from lfmesh.transport.render.progress import Progress
    from lfmesh.transport.trace import Status, trace
    from lfmesh.transport.traced_paths import Paths
    from lfmesh.transport.world import World
    from lfmesh.view.layout.figure import draw
    from lfmesh.view.lens_sheet import draw_lens_sheet
    from lfmesh.view.rays.exact_ghosts import ExactGhosts, exact_ghosts
    from lfmesh.view.show import show
    from lfmesh.waves.point_spread import PointSpread, point_spread
    from lfmesh.waves.render import render
    from lfmesh.waves.wavefront import Wavefront, wavefront

__all__ = [
    "Air",
    "AllInFocus",
    "ArrayForm",
    "AxialGradient",
    "BackFace",
    "Band",
    "Biconic",
    "BlackPictureWarning",
    "BlindCheckWarning",
    "Board",
    "BoardCorners",
    "BoardFit",
    "Box",
    "Calibration",
    "Camera",
    "CameraModel",
    "CircularPolarisation",
    "ClearAirWarning",
    "ClosedGapWarning",
    "CoarseFieldWarning",
    "Coating",
    "Cover",
    "CutBodiesWarning",
    "CutPathsWarning",
    "Cylinder",
    "Dataset",
    "DepthMap",
    "DepthTruth",
    "Detector",
    "DiffractionWarning",
    "DirectionalLight",
    "Disk",
    "DiskLight",
    "Element",
    "Event",
    "ExactGhosts",
    "Exposed",
    "Exposure",
    "FileError",
    "FineVoxelsWarning",
    "Finish",
    "FirstOrder",
    "Fit",
    "FocalStack",
    "FoldedPatchesWarning",
    "GlassError",
    "Gloss",
    "GradientDispersion",
    "GradiumGradient",
    "GratingPhase",
    "Grid",
    "GridPhase",
    "HeavyPathsWarning",
    "HenyeyGreensteinPhase",
    "HiddenSceneWarning",
    "HologramPhase",
    "Image",
    "InterruptedRenderWarning",
    "IsotropicPhase",
    "Layer",
    "Ledger",
    "Lens",
    "LensAnalysis",
    "LfmeshError",
    "LightField",
    "LightOutsideAimWarning",
    "LineLight",
    "LinearPolarisation",
    "Liquid",
    "LostEnergyWarning",
    "Material",
    "Matter",
    "MeasuredDisplacement",
    "MeasuredIndex",
    "MeasuredReflectance",
    "Medium",
    "MeshBounds",
    "MeshError",
    "MeshFace",
    "MetalensPhase",
    "MicrolensArray",
    "MiePhase",
    "MissedLightWarning",
    "Motion",
    "OpenLedgerWarning",
    "Optimum",
    "Order",
    "OrderCheckWarning",
    "OuterZone",
    "OwnGlass",
    "Particles",
    "Paths",
    "PhaseZone",
    "Photograph",
    "PictureWarning",
    "Plane",
    "PointLight",
    "PointSpread",
    "Pose",
    "Progress",
    "ProjectionMatrix",
    "Qbfs",
    "Qcon",
    "RadialGradient",
    "RadialPhase",
    "RadialSquareGradient",
    "RayModel",
    "RayleighPhase",
    "Reconstruction",
    "RectangleLight",
    "Refractor",
    "RotationDisplacement",
    "Scene",
    "SceneError",
    "Schlieren",
    "SelfocGradient",
    "Sensor",
    "Sheet",
    "Spectrum",
    "Sphere",
    "SphericalGradient",
    "SpotLight",
    "Status",
    "Study",
    "Surface",
    "TabulatedPhase",
    "Tank",
    "Target",
    "Tessellation",
    "TimedPose",
    "TooFewSamplesWarning",
    "Toroid",
    "Transport",
    "UniformDisplacement",
    "UnknownErrorWarning",
    "VortexDisplacement",
    "VoxelBox",
    "Wall",
    "Wavefront",
    "World",
    "XyPhase",
    "XyzGradient",
    "ZonedPhase",
    "__version__",
    "all_in_focus",
    "analyse",
    "asset_path",
    "build",
    "calibrate",
    "camera_model",
    "decode",
    "depth_truth",
    "displaced",
    "draw",
    "draw_lens_sheet",
    "estimate_centres",
    "estimate_depth",
    "exact_ghosts",
    "export_field",
    "export_raw",
    "first_order",
    "fit",
    "fit_boards",
    "focal_stack",
    "focused",
    "load",
    "loads",
    "object_rays",
    "open_projection_matrix",
    "open_run",
    "open_white",
    "optimise",
    "particle_vectors",
    "patches_in_focus",
    "point_spread",
    "projection_matrix",
    "reconstruct",
    "refocus",
    "render",
    "render_patches",
    "save",
    "save_white",
    "schlieren",
    "show",
    "solved",
    "trace",
    "volume_quality",
    "wavefront",
    "white_image",
    "write_camera_model",
    "write_projection_matrix",
]

_HOMES = {
    "lfmesh.analysis.analysis": ["LensAnalysis", "analyse"],
    "lfmesh.assets": ["asset_path"],
    "lfmesh.errors": [
        *["FileError", "GlassError", "LfmeshError", "MeshError", "SceneError"],
        "BlackPictureWarning",
        "BlindCheckWarning",
        "ClearAirWarning",
        "ClosedGapWarning",
        "CoarseFieldWarning",
        "CutBodiesWarning",
        "CutPathsWarning",
        "DiffractionWarning",
        "FineVoxelsWarning",
        "FoldedPatchesWarning",
        "HeavyPathsWarning",
        "HiddenSceneWarning",
        "InterruptedRenderWarning",
        "LightOutsideAimWarning",
        "LostEnergyWarning",
        "MissedLightWarning",
        "OpenLedgerWarning",
        "OrderCheckWarning",
        "PictureWarning",
        "TooFewSamplesWarning",
        "UnknownErrorWarning",
    ],
    "lfmesh.files.camera_model": ["write_camera_model"],
    "lfmesh.files.exports.export": ["export_field", "export_raw"],
    "lfmesh.files.matrix": ["open_projection_matrix", "write_projection_matrix"],
    "lfmesh.files.run": ["open_run", "open_white", "save", "save_white"],
    "lfmesh.geometry.lens.solved_camera": ["first_order"],
    "lfmesh.lightfield.calibration.calibration": ["Calibration", "calibrate"],
    "lfmesh.lightfield.rays.camera_model": ["CameraModel", "camera_model"],
    "lfmesh.lightfield.calibration.centres": ["estimate_centres"],
    "lfmesh.lightfield.views.decode": ["decode"],
    "lfmesh.lightfield.photographs.depth": ["DepthMap", "estimate_depth"],
    "lfmesh.lightfield.photographs.depth_truth": ["DepthTruth", "depth_truth"],
    "lfmesh.lightfield.detector": ["Detector", "Exposed"],
    "lfmesh.lightfield.views.field": ["LightField"],
    "lfmesh.lightfield.rays.object_rays": ["object_rays"],
    "lfmesh.lightfield.views.focused": ["focused"],
    "lfmesh.lightfield.views.patches": ["patches_in_focus", "render_patches"],
    "lfmesh.lightfield.photographs.photograph": ["AllInFocus", "FocalStack", "Photograph", "all_in_focus"],
    "lfmesh.lightfield.volumes.projection": ["projection_matrix"],
    "lfmesh.lightfield.volumes.projection_matrix": ["ProjectionMatrix"],
    "lfmesh.lightfield.rays.ray_model": ["RayModel"],
    "lfmesh.lightfield.volumes.reconstruction": ["Reconstruction", "reconstruct", "volume_quality"],
    "lfmesh.lightfield.photographs.refocus": ["focal_stack", "refocus"],
    "lfmesh.lightfield.photographs.schlieren": ["Schlieren", "schlieren"],
    "lfmesh.lightfield.volumes.voxel_box": ["VoxelBox"],
    "lfmesh.lightfield.calibration.white": ["white_image"],
    "lfmesh.scene": [
        *["Scene", "Camera", "Lens", "Surface", "MicrolensArray", "ArrayForm", "BackFace", "Sensor", "Pose", "Target"],
        *["Material", "Plane", "Disk", "Sphere", "Box", "Cylinder", "PointLight", "DirectionalLight"],
        *[
            "Gloss",
            "DiskLight",
            "RectangleLight",
            "LineLight",
            "SpotLight",
            "Transport",
            "Tessellation",
            "Refractor",
            "Liquid",
            "Matter",
            "Tank",
            "Wall",
            "FirstOrder",
            "load",
            "loads",
            "solved",
        ],
    ],
    "lfmesh.scene.camera.bands": ["Band"],
    "lfmesh.scene.camera.cover": ["Cover"],
    "lfmesh.scene.camera.gradient": [
        "AxialGradient",
        "GradientDispersion",
        "GradiumGradient",
        "RadialGradient",
        "RadialSquareGradient",
        "SelfocGradient",
        "SphericalGradient",
        "XyzGradient",
    ],
    "lfmesh.scene.camera.lens": ["Element"],
    "lfmesh.scene.camera.outer_zone": ["OuterZone"],
    "lfmesh.scene.camera.phase": [
        "GratingPhase",
        "GridPhase",
        "HologramPhase",
        "MetalensPhase",
        "Order",
        "PhaseZone",
        "RadialPhase",
        "XyPhase",
        "ZonedPhase",
    ],
    "lfmesh.scene.camera.qbfs": ["Qbfs"],
    "lfmesh.scene.camera.qcon": ["Qcon"],
    "lfmesh.scene.camera.sections": ["Biconic", "Toroid"],
    "lfmesh.scene.light.lights": ["CircularPolarisation", "LinearPolarisation"],
    "lfmesh.scene.light.spectra": ["Spectrum"],
    "lfmesh.scene.materials.coatings": ["Coating", "Layer", "MeasuredIndex", "MeasuredReflectance"],
    "lfmesh.scene.materials.finishes": ["Finish"],
    "lfmesh.scene.materials.own_glass": ["OwnGlass"],
    "lfmesh.scene.motion": ["Exposure", "Motion", "TimedPose"],
    "lfmesh.scene.media.air": ["Air"],
    "lfmesh.scene.media.media": ["Grid", "Medium", "MeshBounds"],
    "lfmesh.scene.media.phase": [
        "HenyeyGreensteinPhase",
        "IsotropicPhase",
        "MiePhase",
        "RayleighPhase",
        "TabulatedPhase",
    ],
    "lfmesh.scene.objects.refractor": ["MeshFace"],
    "lfmesh.scene.light.particles": [
        "MeasuredDisplacement",
        "Particles",
        "RotationDisplacement",
        "Sheet",
        "UniformDisplacement",
        "VortexDisplacement",
    ],
    "lfmesh.scene.particle_frames": ["displaced", "particle_vectors"],
    "lfmesh.study.datasets.dataset": ["Dataset"],
    "lfmesh.study.fits.board_corners": ["BoardCorners"],
    "lfmesh.study.fits.board_fit": ["BoardFit", "fit_boards"],
    "lfmesh.study.fits.board_pictures": ["Board"],
    "lfmesh.study.fits.fit": ["Fit", "fit"],
    "lfmesh.study.optimise.optimise": ["Optimum", "optimise"],
    "lfmesh.study.sweeps.study": ["Study"],
    "lfmesh.transport.render.image": ["Image"],
    "lfmesh.transport.packets.ledger": ["Ledger"],
    "lfmesh.transport.packets.packet": ["Event"],
    "lfmesh.transport.render.progress": ["Progress"],
    "lfmesh.transport.trace": ["Status", "trace"],
    "lfmesh.transport.traced_paths": ["Paths"],
    "lfmesh.transport.build": ["build"],
    "lfmesh.transport.world": ["World"],
    "lfmesh.view.layout.figure": ["draw"],
    "lfmesh.view.lens_sheet": ["draw_lens_sheet"],
    "lfmesh.view.rays.exact_ghosts": ["ExactGhosts", "exact_ghosts"],
    "lfmesh.view.show": ["show"],
    "lfmesh.waves.point_spread": ["PointSpread", "point_spread"],
    "lfmesh.waves.render": ["render"],
    "lfmesh.waves.wavefront": ["Wavefront", "wavefront"],
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}

show_by(partial(import_module, "lfmesh.view.results"), partial(import_module, "lfmesh.view.progress"))


def __getattr__(name: str) -> Any:
    if name == "__version__":
        value: Any = _version()
    elif name in _HOME:
        home = import_module(_HOME[name])
        value = getattr(home, name)
        if isfunction(value):
            value = with_checked_arguments(value)
            # Pickle looks functions up in their home module.
            setattr(home, name, value)
    else:
        raise AttributeError(f"module 'lfmesh' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("lfmesh")
    except PackageNotFoundError:  # a checkout on the path that was never installed
        return "0+uninstalled"

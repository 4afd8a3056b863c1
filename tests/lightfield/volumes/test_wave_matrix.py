"""Matrices with diffraction: columns are point spreads, repeated where the camera repeats itself."""

import re
import warnings

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.scene import Scene
from lfmesh.waves.pictures import pictures_of_points, repeats_of
from lfmesh.waves.point_spread import TOLERANCE


def microscope(**changes: object) -> Scene:
    scene = lf.load(asset_path("scenes/light_field_microscope.toml"))
    return scene.changed({"targets": (), "transport.threads": 1, **changes})


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::lfmesh.errors.DiffractionWarning")
def test_columns_are_the_point_spreads_of_voxels_a_lenslet_apart() -> None:
    scene, grid = microscope(), lf.VoxelBox.of_size((3, 1, 1), (0.0375, 0.0125, 0.01), (0.0, 0.0, -18.03))
    matrix = lf.projection_matrix(scene, grid)
    assert matrix.stderr.max() == 0.0
    volume = np.prod(grid.spacing_mm)
    for voxel, point in enumerate(grid.centres_mm().reshape(-1, 3)):
        own = lf.point_spread(scene, point).mean.ravel() * volume
        assert np.abs(matrix.matrix[:, [voxel]].toarray().ravel() - own).sum() < 3e-3 * own.sum()


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::lfmesh.errors.DiffractionWarning")
def test_mirrored_points_have_mirrored_pictures() -> None:
    """Of 16 voxels 3 spreads are computed, and one more that checks; each mirror shows in one of the voxels."""
    scene, grid = microscope(), lf.VoxelBox.of_size((4, 4, 1), (0.0125, 0.0125, 0.001), (0.0, 0.0, -18.02))
    points = grid.centres_mm().reshape(-1, 3)
    found = pictures_of_points(scene, points, 550.0)
    assert found.computed == 4
    assert found.error <= TOLERANCE
    for voxel in (1, 6, 14):
        own = lf.point_spread(scene, points[voxel]).mean
        assert np.abs(found.mean[voxel] - own).sum() < TOLERANCE * own.sum()


def test_the_microscope_repeats_itself_from_lenslet_to_lenslet() -> None:
    repeats = repeats_of(microscope())
    assert repeats is not None
    assert repeats.object_mm == pytest.approx(0.0125)
    assert repeats.pixels == -10
    assert repeats.mirrors
    for off in ({"camera.mla.pose.shift_mm": (0.01, 0.0, 0.0)}, {"camera.mla.count": (9, 8)}):
        aside = repeats_of(microscope(**off))
        assert aside is not None
        assert not aside.mirrors
    assert repeats_of(microscope(**{"camera.sensor.pixel_mm": 0.0126})) is None
    assert repeats_of(lf.load(asset_path("scenes/first_light.toml"))) is None


def test_media_are_refused() -> None:
    fog = {"scattering_per_mm": 0.01, "shape": {"kind": "sphere", "radius_mm": 1.0}, "position_mm": (0.0, 0.0, -15.0)}
    grid = lf.VoxelBox.of_size((1, 1, 1), (0.01, 0.01, 0.01), (0.0, 0.0, -18.0))
    with pytest.raises(lf.LfmeshError, match="media"):
        lf.projection_matrix(microscope(media=(fog,)), grid, absorption=True)


@pytest.mark.parametrize(("shape", "wide_mm"), [((1, 1, 1), 0.6), ((3, 1, 1), 0.3)])
def test_voxels_wider_than_a_point_spread_are_warned_of_with_their_error(
    shape: tuple[int, int, int], wide_mm: float
) -> None:
    """That of a column: against the mean over points of the voxel, at f/25 without an array; of fine voxels none."""
    far, image = 2000.0, 50.0
    lens = [
        {"paraxial": True, "focal_length_mm": 1.0 / (1.0 / image + 1.0 / far), "stop": True, "semi_diameter_mm": 1.0}
    ]
    camera = {"lens": {"surfaces": lens}, "sensor": {"pixels": [24, 24], "pixel_mm": 0.01, "distance_mm": image}}
    scene = Scene.model_validate(
        {"schema_version": 1, "camera": camera, "transport": {"diffraction": "stop", "split": "transmit", "threads": 1}}
    )

    def said(wide_mm: float) -> list[str]:
        grid = lf.VoxelBox.of_size(shape, np.multiply(shape, (wide_mm, 0.01, 0.01)), (0.0, 0.0, -far))
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("always", lf.DiffractionWarning)
            lf.projection_matrix(scene, grid, pixels=[300], threshold=0.0)
        return [str(each.message) for each in found if "whole voxels" in str(each.message)]

    assert said(0.05) == []
    (words,) = said(wide_mm)
    stated = 0.01 * float(re.findall(r"by about ([0-9.]+) ?%", words)[0])
    spreads = [lf.point_spread(scene, (wide_mm * (x / 8.0 - 0.4375), 0.0, -far)).mean for x in range(8)]
    middle = lf.point_spread(scene, (0.0, 0.0, -far)).mean
    assert stated == pytest.approx(np.abs(np.mean(spreads, axis=0) - middle).sum() / middle.sum(), rel=0.25)

"""Light on its way through the water that a camera looks into: absorption, voxels that shine, both methods, gloss."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy import stats

import lfmesh as lf
from lfmesh.geometry.frame import rotation
from lfmesh.lightfield.volumes.projection import projection_matrix
from lfmesh.lightfield.volumes.voxel_box import VoxelBox
from lfmesh.optics.gltf_material import DIELECTRIC_INDEX
from tests.cameras import camera_without_array, close_up_camera
from tests.renders import by_seed
from tests.validation.test_object_medium import IN_WATER, WATER, fan, lit_in_water, through_port

LEVEL = 1e-3
"""Of all comparisons of a test together, after Bonferroni."""


@pytest.mark.parametrize("engine", ["mesh", "sequential"])
def test_dye_before_a_port_weakens_light_along_its_way_in_water(engine: str) -> None:
    """exp(−κ s) of the same rays in clear water, s straight through a turned slab; the port bends them behind it."""
    draw = np.random.default_rng(7)
    start, ahead = fan(48, -60.0)
    for _ in range(2):
        turn, thick, kappa = draw.uniform(-20.0, 20.0, 3), draw.uniform(5.0, 20.0), draw.uniform(0.002, 0.2)
        slab = {"bounds": {"kind": "box", "size_mm": [60.0, 60.0, thick]}, "position_mm": [0.0, 0.0, -28.0],
                "rotation_deg": turn.tolist(), "absorption_per_mm": kappa}  # fmt: skip
        clear = through_port().changed({"transport.engine": engine})
        ends = []
        for scene in (clear, clear.changed({"media": [slab]})):
            paths = lf.trace(lf.build(scene), start, ahead, split="transmit")
            landed = paths.status == lf.Status.SENSOR
            ends.append((np.bincount(paths.source[landed], paths.weight[landed], 48), paths.position[landed]))
        (bright, place), (dim, same) = ends
        np.testing.assert_array_equal(same, place)
        seen = bright > 0.0
        assert seen.sum() > 10
        depth = kappa * thick / np.abs(ahead @ rotation(turn)[:, 2])
        np.testing.assert_allclose(dim[seen] / bright[seen], np.exp(-depth[seen]), rtol=1e-12)


@pytest.mark.filterwarnings("ignore::lfmesh.errors.TooFewSamplesWarning")
def test_columns_of_a_matrix_are_the_images_of_voxels_that_shine_in_water(tmp_path: Path) -> None:
    """Of two voxels, one at a time, each rendered as a medium, by the same paths; in air the images are others."""
    settings = {"samples": 8, "replicates": 4, "split": "transmit", "threads": 1, "seed": 3}
    scene = lf.Scene(camera=close_up_camera(16, 16), transport=settings).changed(IN_WATER).in_folder(tmp_path)
    pose = {"position_mm": (0.4, -0.3, -60.0), "rotation_deg": (20.0, -35.0, 50.0)}
    grid = VoxelBox.of_size((5, 4, 6), (9.0, 8.0, 14.0), **pose)
    wet = projection_matrix(scene, grid, threshold=0.0)
    dry = projection_matrix(scene.changed({"camera.object_medium": {"index": 1.0}}), grid, threshold=0.0)
    brightest = np.argsort(np.asarray(wet.matrix.sum(axis=0)).ravel())
    for voxel in brightest[[-1, -10]]:
        emission = np.zeros(grid.shape)
        emission.flat[voxel] = 1.0
        place = {"spacing_mm": grid.spacing_mm, "origin_mm": grid.origin_mm}
        np.savez(tmp_path / "grid.npz", emission_w_mm3_sr=emission, **place)
        medium = {"grid": {"file": "grid.npz", "interpolation": "constant"}, **pose}
        image = lf.render(scene.changed({"media": [medium]})).mean.ravel()
        assert (image > 0.0).sum() > 5
        np.testing.assert_allclose(wet.image(emission), image, rtol=1e-9, atol=1e-11 * image.max())
        assert np.abs(dry.image(emission) - image).max() > 0.1 * image.max()


def test_forward_equals_adjoint_in_water() -> None:
    """Sums of the quarters of the picture, and all of it, over independent renders: Welch's t-test."""
    sums = []
    for method, seeds, samples in (("adjoint", range(8), 16), ("forward", range(100, 124), 64)):
        scene = lit_in_water(**{"transport.method": method, "transport.samples": samples, "transport.replicates": 1})
        images = np.array([image.mean[..., 0] for image in by_seed(scene, seeds)])
        quarters = images.reshape(len(images), 2, 10, 2, 10).sum(axis=(2, 4)).reshape(len(images), 4)
        sums.append(np.column_stack([quarters, quarters.sum(axis=1)]))
    assert (stats.sem(sums[1]) < 0.05 * sums[1].mean(axis=0)).all()
    found = stats.ttest_ind(*sums, equal_var=False).pvalue
    assert len(found) * found.min() > LEVEL, found


def plate_of_a_file(folder: Path, metallic: float) -> lf.Scene:
    """Return a camera in water before a plate whose glTF file gives it a gloss."""
    corners = [[-0.04, -0.04, 0.0], [0.04, -0.04, 0.0], [0.04, 0.04, 0.0], [-0.04, 0.04, 0.0]]
    plate = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    colour = trimesh.visual.material.PBRMaterial(
        baseColorFactor=[204, 204, 204, 255], metallicFactor=metallic, roughnessFactor=0.5
    )
    plate.visual = trimesh.visual.TextureVisuals(uv=np.zeros((4, 2)), material=colour)
    trimesh.Scene(plate).export(folder / "plate.glb")
    return lf.Scene(
        camera=camera_without_array(), targets=[{"file": "plate.glb", "position_mm": [0.0, 0.0, -150.0]}]
    ).in_folder(folder)


def test_gloss_of_a_file_needs_an_index_not_below_the_liquids(tmp_path: Path) -> None:
    """Metal has its colour in any liquid; a matt material in place of the file's has no gloss."""
    oil = {"camera.object_medium": {"index": DIELECTRIC_INDEX + 0.01}}
    scene = plate_of_a_file(tmp_path, 0.0)
    with pytest.raises(
        lf.SceneError, match=r"targets\[0\]\.file = 'plate\.glb': .* below that of camera\.object_medium, 1\.51, "
    ):
        lf.build(scene.changed(oil))
    lf.build(scene.changed(IN_WATER))
    lf.build(scene.changed(oil | {"targets[0].materials": "ignore", "targets[0].material": {"reflectance": 0.5}}))
    lf.build(plate_of_a_file(tmp_path, 1.0).changed(oil))
    assert WATER < DIELECTRIC_INDEX

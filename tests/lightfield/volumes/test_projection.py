"""Projection matrices: rays that are the image's, chords by an independent formula, errors as large as said."""

import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse, stats

import lfmesh as lf
from lfmesh.cli import main
from lfmesh.errors import FileError, LfmeshError
from lfmesh.files import matrix as files
from lfmesh.lightfield.volumes import resolution_messages
from lfmesh.lightfield.volumes.projection import projection_matrix
from lfmesh.lightfield.volumes.projector import Projector
from lfmesh.lightfield.volumes.voxel_box import VoxelBox
from lfmesh.scene import Scene
from tests.cameras import close_up_camera
from tests.frames import motion

ROOT = Path(__file__).resolve().parents[3]
MM2 = 1e-6
POSE = {"position_mm": (0.4, -0.3, -60.0), "rotation_deg": (20.0, -35.0, 50.0)}


def camera(targets=(), tanks=(), **transport):
    settings = {"samples": 8, "replicates": 4, "split": "transmit", "threads": 1, "seed": 3} | transport
    return Scene(camera=close_up_camera(16, 16), targets=targets, tanks=tanks, transport=settings)


def box(counts=(5, 4, 6), size=(9.0, 8.0, 14.0), **pose):
    return VoxelBox.of_size(counts, size, **(POSE | pose))


def plate(z_mm, radiance=2.0, side=40.0):
    return {
        "shape": {"kind": "plane", "width_mm": side, "height_mm": side},
        "position_mm": [0.0, 0.0, z_mm],
        "material": {"reflectance": 0.0, "radiance_w_m2_sr": radiance},
    }


def pieces(projector, pixels):
    """Return all pieces of rays of all replicates, one after another."""
    book = np.zeros(len(projector.world.slots))
    found = [s for r in range(projector.replicates) for s in projector._segments(pixels, r, book)]
    return [np.concatenate(column) for column in zip(*found, strict=True)][:5]


def chords(grid, origin, direction, length):
    """Return the chord of one ray in every voxel, (voxels,), mm: slab after slab, voxel by voxel."""
    turn, place = grid.to_world[:, :3], grid.to_world[:, 3]
    p, d = turn.T @ (origin - place), turn.T @ direction
    inside = []
    for axis in range(3):
        low = grid.origin_mm[axis] + grid.spacing_mm[axis] * (np.arange(grid.shape[axis]) - 0.5)
        ends = np.stack([low - p[axis], low + grid.spacing_mm[axis] - p[axis]]) / d[axis]
        inside.append(np.sort(ends, axis=0))
    enter, leave = (
        pick(
            pick(inside[0][side][:, None, None], inside[1][side][None, :, None]), inside[2][side][None, None, :]
        )
        for side, pick in ((0, np.maximum), (1, np.minimum))
    )  # fmt: skip
    return np.maximum(np.minimum(leave, length) - np.maximum(enter, 0.0), 0.0).ravel()


PIXELS = np.array([40, 41, 100, 119, 120, 135, 136, 200])


def test_every_entry_is_weight_times_chord_of_rays_that_end_on_its_pixel():
    grid = box()
    projector = Projector(camera(), grid, threshold=0.0)
    origin, direction, length, weight, pixel = pieces(projector, PIXELS)
    assert np.isinf(length).all()
    expected = np.zeros((len(PIXELS), grid.voxels))
    for o, d, t, w, number in zip(origin, direction, length, weight, pixel, strict=True):
        expected[np.searchsorted(PIXELS, number)] += w / MM2 * chords(grid, o, d, t) / projector.replicates
    made = projection_matrix(camera(), grid, pixels=PIXELS, threshold=0.0)
    np.testing.assert_allclose(made.matrix.toarray(), expected, rtol=1e-11, atol=1e-13 * expected.max())
    assert made.matrix.nnz > 100
    # Turned round, each ray goes through lens and array to that pixel.
    world = projector.world
    paths = lf.trace(world, origin + 30.0 * direction, -direction, split="transmit")
    assert (paths.status == lf.Status.SENSOR).all()
    turn = motion(world, "world", "sensor")
    x, y = (paths.position @ turn[:, :3].T + turn[:, 3]).T[:2] / world.scene.camera.sensor.pixel_mm + 8.0
    column, row = pixel % 16, pixel // 16
    for place, low in ((x, column), (y, row)):
        assert (place > low - 1e-6).all()
        assert (place < low + 1 + 1e-6).all()


BANDS = [{"name": "a", "center_nm": 500.0, "fwhm_nm": 40.0}, {"name": "b", "center_nm": 600.0, "fwhm_nm": 60.0}]


@pytest.mark.parametrize(("split", "bands"), [("transmit", None), ("both", None), ("transmit", BANDS)])
def test_rays_carry_the_rendered_image_of_what_they_end_on(split, bands):
    """The power of a plate that emits, to rounding: the rays are the image's own."""
    scene = camera([plate(-60.0)], split=split)
    if bands is not None:
        scene = scene.changed({"camera.sensor.bands": bands})
    channel = scene.channels - 1
    image = lf.render(scene).mean[..., channel].ravel()
    projector = Projector(scene, box(position_mm=(0.0, 0.0, -30.0)), channel)
    _, _, length, weight, pixel = pieces(projector, projector.all_pixels)
    seen = np.bincount(pixel, np.where(np.isfinite(length), 2.0 * weight, 0.0), len(image)) / projector.replicates
    np.testing.assert_allclose(seen, image, rtol=1e-11, atol=1e-13 * image.max())
    assert (image > 0.0).sum() > 100


def shining(scene, grid, emission, folder):
    """Return a scene in which the voxels of a grid shine, each evenly, as a medium."""
    place = {"spacing_mm": grid.spacing_mm, "origin_mm": grid.origin_mm}
    np.savez(folder / "grid.npz", emission_w_mm3_sr=emission, **place)
    medium = {
        "grid": {"file": "grid.npz", "interpolation": "constant"},
        "position_mm": grid.position_mm.tolist(),
        "rotation_deg": grid.rotation_deg.tolist(),
    }
    return scene.changed({"media": [medium]}).in_folder(folder)


WINDOW = {"refractor": {"box_mm": [60.0, 60.0, 3.0], "index": 1.5}, "position_mm": [0.0, 0.0, -40.0],
          "rotation_deg": [12.0, 20.0, 0.0]}  # fmt: skip


@pytest.mark.parametrize(
    ("targets", "split"),
    [
        ([], "transmit"),
        ([plate(-61.0, 0.0)], "both"),
        ([WINDOW], "both"),
        pytest.param([WINDOW], "transmit", marks=pytest.mark.long),
    ],
)
def test_matrix_times_emission_is_the_rendered_image_of_the_emission(targets, split, tmp_path):
    """To rounding by the same paths; by others a z-test of the sum and of each sixteenth, 17 of a level of 0.001.

    Where glass reflects, roulette takes other paths in the two.
    """
    grid = box()
    emission = 1e-6 * np.random.default_rng(4).random(grid.shape) ** 3
    scene = camera(targets, split=split, samples=64, replicates=16)
    image = lf.render(shining(scene, grid, emission, tmp_path))
    seen = projection_matrix(scene, grid, threshold=0.0).image(emission)
    if split == "transmit" or WINDOW not in targets:
        np.testing.assert_allclose(seen, image.mean.ravel(), rtol=1e-9, atol=1e-12 * seen.max())
    assert (seen > 0.0).mean() > 0.5
    other = projection_matrix(scene.changed({"transport.seed": 8}), grid, threshold=0.0)
    # Replicates of different seeds are independent; those of a matrix have about the errors of the image.
    across = image.mean[..., 0] - other.image(emission).reshape(16, 16)
    error = np.sqrt(2.0) * image.stderr[..., 0]
    blocks = (4, 4, 4, 4)
    z = across.reshape(blocks).sum(axis=(1, 3)) / np.sqrt((error**2).reshape(blocks).sum(axis=(1, 3)))
    z = np.append(z, across.sum() / np.linalg.norm(error))
    assert 2.0 * stats.norm.sf(np.abs(z).max()) > 1e-3 / len(z), z


def test_a_target_hides_what_lies_behind_it_and_nothing_before_it():
    grid = box((3, 3, 8), (9.0, 9.0, 16.0), rotation_deg=(0.0, 0.0, 0.0), position_mm=(0.0, 0.0, -60.0))
    free = projection_matrix(camera(), grid).matrix.toarray().reshape(-1, *grid.shape)
    half = projection_matrix(camera([plate(-60.0)]), grid).matrix.toarray().reshape(-1, *grid.shape)
    assert free[..., :4].sum() > 0.0
    assert not half[..., :4].any()
    np.testing.assert_allclose(half[..., 4:], free[..., 4:], rtol=1e-9, atol=1e-12 * free.max())


def test_a_grid_in_a_tank_is_seen_along_the_refracted_rays():
    """Window and water: pieces between the vertices that `lf.trace` records, radiance over n² in the water."""
    index = 1.333
    tank = {
        "size_mm": [40.0, 40.0, 40.0], "wall_mm": 3.0, "wall": {"index": 1.52}, "liquid": {"index": index},
        "position_mm": [0.0, 0.0, -62.0], "rotation_deg": [8.0, -12.0, 5.0],
    }  # fmt: skip
    grid = box()
    scene = camera(tanks=[tank])
    rays = Projector(scene, grid)
    world = rays.world
    expected = np.zeros((len(PIXELS), grid.voxels))
    found = pieces(rays, PIXELS)
    # Those that start at the lens, before the tank.
    at_lens = found[0][:, 2] > -10.0
    origin, direction, _, weight, pixel = (column[at_lens] for column in found)
    # A ray that starts on the lens would be refracted by it.
    paths = lf.trace(world, origin + direction, direction, split="transmit", record=True)
    for k in range(len(paths)):
        ray = paths.source[k]
        way = paths.vertices(k)
        for here, there in pairwise(way):
            step = there.position - here.position
            long = np.linalg.norm(step)
            if long == 0.0:
                continue
            share = here.weight * weight[ray] / MM2 / rays.replicates / index**2
            expected[np.searchsorted(PIXELS, pixel[ray])] += share * chords(grid, here.position, step / long, long)
    made = projection_matrix(scene, grid, pixels=PIXELS, threshold=0.0, inside="tanks[0] liquid").matrix.toarray()
    np.testing.assert_allclose(made, expected, rtol=1e-9, atol=1e-11 * expected.max())
    without = projection_matrix(camera(), grid, pixels=PIXELS, threshold=0.0).matrix.toarray()
    assert np.abs(made - without / index**2).max() > 0.05 * made.max()


def test_rows_are_the_same_bits_with_any_pixels_and_threads():
    grid = box()
    whole = projection_matrix(camera([plate(-64.0)], split="both"), grid)
    some = projection_matrix(camera([plate(-64.0)], split="both", threads=2), grid, pixels=PIXELS)
    rows = whole.matrix[PIXELS]
    np.testing.assert_array_equal(some.matrix.indices, rows.indices)
    np.testing.assert_array_equal(some.matrix.data, rows.data)
    np.testing.assert_array_equal(some.row_stderr, whole.row_stderr[PIXELS])


def test_standard_errors_are_as_large_as_the_spread_between_seeds():
    """Student's t of two matrices with 16 replicates each has the variance ν/(ν − 2), ν = 30, in each row sum."""
    made = [projection_matrix(camera(samples=64, replicates=16, seed=seed), box()) for seed in (1, 2)]
    sums = [np.asarray(m.matrix.sum(axis=1)).ravel() for m in made]
    spread = np.hypot(made[0].row_stderr, made[1].row_stderr)
    lit = spread > 0.0
    t2 = ((sums[0] - sums[1]) / np.where(lit, spread, 1.0))[lit] ** 2
    variance, count = 30.0 / 28.0, lit.sum()
    assert count > 150
    # Of t² the variance is 2 ν² (ν − 1)/((ν − 2)² (ν − 4)); five of its standard errors. Sobol' points shape the tails.
    scatter = np.sqrt(2.0 * 30.0**2 * 29.0 / (28.0**2 * 26.0) / count)
    assert abs(t2.mean() - variance) < 5.0 * scatter
    entry = made[0].stderr
    assert entry.shape == made[0].matrix.data.shape
    assert (entry >= 0.0).all()
    assert np.median(entry / made[0].matrix.data) < 0.5


def test_dropped_entries_are_booked():
    full = projection_matrix(camera(), box(), threshold=0.0)
    thin = projection_matrix(camera(), box(), threshold=0.1)
    assert not full.dropped.any()
    assert full.dropped_share == 0.0
    assert thin.matrix.nnz < full.matrix.nnz
    largest = full.matrix.max(axis=1).toarray().ravel()
    assert (thin.matrix.data >= 0.1 * np.repeat(largest, np.diff(thin.matrix.indptr)) * (1 - 1e-12)).all()
    np.testing.assert_allclose(thin.matrix.sum(axis=1) + thin.dropped, full.matrix.sum(axis=1), rtol=1e-12)
    share = thin.dropped.sum() / full.matrix.sum()
    assert thin.dropped_share == pytest.approx(share, rel=1e-10)
    assert 0.0 < share < 0.2


def test_a_matrix_that_was_cut_short_goes_on_to_the_same_bytes(tmp_path, monkeypatch):
    monkeypatch.setattr("lfmesh.lightfield.volumes.projector.RAYS_AT_ONCE", 400)
    said = []
    whole = lf.write_projection_matrix(camera(), box(), tmp_path / "whole.npz", say=said.append)
    assert "256 pixels × 120 voxels: about" in said[0]

    class Stop(Exception):  # noqa: N818
        pass

    def stop(done, total):
        assert total == 256
        if done >= 100:
            raise Stop

    with pytest.raises(Stop):
        lf.write_projection_matrix(camera(), box(), tmp_path / "cut.npz", progress=stop)
    assert not (tmp_path / "cut.npz").exists()
    with pytest.raises(FileError, match=r"cut\.npz\.parts holds blocks of another matrix"):
        lf.write_projection_matrix(camera(seed=4), box(), tmp_path / "cut.npz")
    finished = []
    lf.write_projection_matrix(
        camera(), box(), tmp_path / "cut.npz", say=said.append, progress=lambda done, _: finished.append(done)
    )
    assert finished[0] > 100
    assert said[-2].startswith("continues after")
    assert "of their sum dropped" in said[-1]
    assert not (tmp_path / "cut.npz.parts").exists()
    made = projection_matrix(camera(), box())
    for path in (whole, tmp_path / "cut.npz"):
        read = lf.open_projection_matrix(path)
        np.testing.assert_array_equal(read.matrix.toarray(), made.matrix.toarray())
        for name in ("stderr", "row_stderr", "dropped", "pixels"):
            np.testing.assert_array_equal(getattr(read, name), getattr(made, name))
        assert read.image_shape == made.image_shape == (16, 16)
        np.testing.assert_array_equal(read.grid.centres_mm(), made.grid.centres_mm())
        np.testing.assert_array_equal(sparse.load_npz(path).toarray(), made.matrix.toarray())


def test_hdf5_holds_the_same(tmp_path):
    pytest.importorskip("h5py")
    path = lf.write_projection_matrix(camera(), box(), tmp_path / "m.h5")
    made, read = projection_matrix(camera(), box()), lf.open_projection_matrix(path)
    np.testing.assert_array_equal(read.matrix.toarray(), made.matrix.toarray())
    np.testing.assert_array_equal(read.stderr, made.stderr)
    assert read.wavelength_nm == made.wavelength_nm


def wider(seed):
    """Return the scene of a camera with 10 × 10 lenslets."""
    scene = camera(samples=128, seed=seed)
    return scene.changed({"camera.mla.count": [10, 10], "camera.sensor.pixels": [50, 50]})


def blobs(grid):
    """Return two Gaussian balls of different size and brightness, one behind the other and beside it."""
    at = (grid.centres_mm() - [0.0, 0.0, -60.0]) / [1.0, 1.0, 5.0]
    far, near = (np.square(at - np.array(place)).sum(axis=-1) for place in ((-1.4, 0.8, -2.4), (1.6, -1.0, 2.4)))
    return np.exp(-far / 4.0) + 0.6 * np.exp(-near / 3.0)


@pytest.mark.parametrize(("method", "least"), [("nnls", 0.97), ("mart", 0.97), ("sart", 0.95), ("tikhonov", 0.97)])
def test_two_blobs_are_found_again_in_a_rendered_image(method, least, tmp_path):
    grid = box((6, 6, 4), (9.0, 9.0, 32.0), rotation_deg=(0.0, 0.0, 0.0), position_mm=(0.0, 0.0, -60.0))
    true = blobs(grid)
    image = lf.render(shining(wider(7), grid, true, tmp_path)).mean.ravel()
    found = lf.reconstruct(projection_matrix(wider(8), grid), image, method)
    assert found.volume.shape == grid.shape
    assert found.quality(true) > least
    # A volume without structure in depth is no such match.
    smeared = np.broadcast_to(found.volume.mean(axis=2, keepdims=True), grid.shape)
    assert lf.volume_quality(smeared, true) < 0.8


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: box((0, 2, 2)), r"counts = \[0, 2, 2\]: must be three whole numbers from 1"),
        (lambda: box((2, 2)), "must be three whole numbers"),
        (lambda: box((2.5, 2, 2)), "must be three whole numbers"),
        (lambda: box((10**6, 10**6, 10**6)), "with at most .* voxels"),
        (lambda: box(size=(1.0, -1.0, 1.0)), "size_mm = .*: must be three numbers above 0"),
        (lambda: box(position_mm=(0.0, np.nan, 0.0)), "position_mm = .*: must be three numbers"),
        (lambda: projection_matrix(camera(), "grid"), "grid is str, without shape"),
        (lambda: projection_matrix(camera(), box(position_mm=(0.0, 0.0, 5.0))), "in front of the first lens vertex"),
        (lambda: projection_matrix(camera(), box(position_mm=(500.0, 0.0, -60.0))), "no ray from these pixels meets"),
        (lambda: projection_matrix(camera(), box(), pixels=[]), "pixels: must be increasing whole numbers"),
        (lambda: projection_matrix(camera(), box(), pixels=[3, 3]), "pixels: must be increasing"),
        (lambda: projection_matrix(camera(), box(), pixels=[256]), "from 0 to 255"),
        (lambda: projection_matrix(camera(), box(), channel=1), "channel = 1: must be a whole number from 0 to 0"),
        (lambda: projection_matrix(camera(), box(), threshold=1.0), "threshold = 1.0: must lie from 0 to below 1"),
        (lambda: projection_matrix(camera(polarisation=True), box()), "transport.polarisation"),
        (lambda: lf.write_projection_matrix(camera(), box(), "m.csv"), "must end in one of .npz, .h5, .hdf5"),
        (lambda: lf.write_projection_matrix(camera(), box(), "no/such/m.npz"), "the folder no/such does not exist"),
        (lambda: lf.open_projection_matrix("missing.npz"), "no such file"),
        (lambda: projection_matrix(camera(), box()).image(np.ones(7)), r"the emission has the shape \(7,\)"),
    ],
)
def test_bad_input_is_told_in_one_line(make, message):
    with pytest.raises(LfmeshError, match=message) as refused:
        make()
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("medium", "dims"),
    [
        ({"absorption_per_mm": 0.01}, True),
        ({"grid": {"file": "smoke.npz"}}, True),
        ({"grid": {"file": "flame.npz"}}, False),
        ({"bounds": {"kind": "sphere", "radius_mm": 1.0}, "emission_w_mm3_sr": 1.0}, False),
    ],
)
def test_media_that_a_matrix_leaves_out_are_named(medium, dims, tmp_path, recwarn):
    ones = np.ones((2, 2, 2))
    np.savez(tmp_path / "smoke.npz", scattering_per_mm=ones, spacing_mm=1.0)
    np.savez(tmp_path / "flame.npz", emission_w_mm3_sr=ones, spacing_mm=1.0)
    scene = camera().changed({"media": [medium | {"name": "cloud", "position_mm": [0, 0, -60.0]}]}).in_folder(tmp_path)
    projection_matrix(scene, box(), pixels=[100])
    assert [str(warning.message).startswith("cloud:") for warning in recwarn] == [True] * dims


@pytest.mark.parametrize("interpolation", ["constant", "trilinear"])
def test_matrix_times_emission_is_the_image_of_a_flame_that_absorbs_in_fog(interpolation, tmp_path):
    """The same rays, the light of each taken step by step: to rounding where voxels are the medium's own."""
    draw = np.random.default_rng(8)
    emission, absorption = draw.uniform(0.5, 2.0, (4, 3, 5)), draw.uniform(0.0, 0.05, (4, 3, 5))
    arrays = {"emission_w_mm3_sr": emission, "absorption_per_mm": absorption}
    np.savez(tmp_path / "flame.npz", spacing_mm=(2.0, 2.5, 3.0), **arrays)
    flame = {"grid": {"file": "flame.npz", "interpolation": interpolation}, **POSE}
    fog = {"absorption_per_mm": 0.01}
    wall = plate(-90.0, radiance=0.0)
    scene = camera([wall]).changed({"media": [flame, fog]}).in_folder(tmp_path)
    grid = VoxelBox.of_size((4, 3, 5), (8.0, 7.5, 15.0), **POSE)
    seen = projection_matrix(scene, grid, absorption=True, threshold=0.0).image(emission)
    image = lf.render(scene).mean.ravel()
    assert image.max() > 0.0
    clear = projection_matrix(scene.changed({"media": ()}), grid, threshold=0.0).image(emission)
    assert 1.5 * image.sum() < clear.sum()
    # Between the centres of voxels a trilinear grid is another flame.
    np.testing.assert_allclose(seen, image, rtol=1e-9 if interpolation == "constant" else 0.5, atol=1e-9 * image.max())


def test_fog_that_scatters_dims_as_much_as_one_that_absorbs():
    fogs = [camera().changed({"media": [{key: 0.02}]}) for key in ("absorption_per_mm", "scattering_per_mm")]
    one, other = (projection_matrix(scene, box(), pixels=range(60, 120), absorption=True).matrix for scene in fogs)
    np.testing.assert_allclose(one.toarray(), other.toarray(), rtol=1e-12)


@pytest.mark.parametrize("absorption_per_mm", [0.0, 0.05])
def test_matrix_times_emission_is_the_image_of_a_flame_in_fog_behind_and_beside_glass(absorption_per_mm, tmp_path):
    """A tilted plate covers part of the view; fog lies before and behind it, and the flame absorbs by voxels."""
    draw = np.random.default_rng(4)
    emission, absorption = draw.uniform(0.5, 2.0, (4, 3, 5)), draw.uniform(0.0, 0.05, (4, 3, 5))
    np.savez(
        tmp_path / "flame.npz", spacing_mm=(2.0, 2.5, 3.0), emission_w_mm3_sr=emission, absorption_per_mm=absorption
    )
    flame = {"grid": {"file": "flame.npz", "interpolation": "constant"}, **POSE}
    fog = {"absorption_per_mm": 0.01}
    glass = {"box_mm": [20.0, 30.0, 4.0], "index": 1.5, "absorption_per_mm": absorption_per_mm}
    window = {"refractor": glass, "position_mm": [10.3, 0.0, -40.0], "rotation_deg": [10.0, 15.0, 0.0]}
    scene = camera([window]).changed({"media": [flame, fog]}).in_folder(tmp_path)
    grid = VoxelBox.of_size((4, 3, 5), (8.0, 7.5, 15.0), **POSE)
    seen = projection_matrix(scene, grid, absorption=True, threshold=0.0).image(emission)
    image = lf.render(scene).mean.ravel()
    lit = image > 0.0
    assert lit.sum() > 100
    np.testing.assert_allclose(seen, image, rtol=1e-9, atol=1e-9 * image.max())
    without = projection_matrix(scene.changed({"targets": ()}), grid, absorption=True, threshold=0.0).image(emission)
    changed = np.abs(without[lit] / seen[lit] - 1.0) > 0.02
    assert changed.sum() > 10
    assert (~changed).sum() > 10


TANK = {
    "size_mm": [40.0, 40.0, 30.0], "wall_mm": 3.0, "wall": {"index": 1.52, "absorption_per_mm": 0.02},
    "liquid": {"index": 1.333, "absorption_per_mm": 0.03}, "position_mm": [0.0, 0.0, -58.0],
    "rotation_deg": [8.0, -12.0, 5.0],
}  # fmt: skip


@pytest.mark.parametrize("dye", [0.0, 0.04])
def test_matrix_times_emission_is_the_image_of_what_shines_in_water(dye, tmp_path):
    """The grid is cut by the tank's walls, which displace it; water, window and dye absorb, and fog before the tank."""
    emission = np.random.default_rng(8).uniform(0.5, 2.0, (4, 3, 5))
    np.savez(tmp_path / "glow.npz", spacing_mm=(2.0, 2.5, 6.0), emission_w_mm3_sr=emission)
    pose = {"position_mm": (0.5, -0.4, -52.0), "rotation_deg": (3.0, 2.0, 10.0)}
    inside = "tanks[0] liquid"
    glow = {"grid": {"file": "glow.npz", "interpolation": "constant"}, "inside": inside, **pose}
    dimming = [{"inside": inside, "scattering_per_mm": dye}, {"absorption_per_mm": 0.01}] if dye else []
    # The medium that shines scatters nothing into the image: the dye is an absorber there.
    absorbing = [{key.replace("scattering", "absorption"): value for key, value in each.items()} for each in dimming]
    scene = camera(tanks=[TANK]).in_folder(tmp_path)
    grid = VoxelBox.of_size((4, 3, 5), (8.0, 7.5, 30.0), **pose)
    with_media = scene.changed({"media": dimming})
    seen = projection_matrix(with_media, grid, absorption=bool(dye), threshold=0.0, inside=inside).image(emission)
    image = lf.render(scene.changed({"media": [glow, *absorbing]})).mean.ravel()
    assert image.max() > 0.0
    np.testing.assert_allclose(seen, image, rtol=1e-9, atol=1e-9 * image.max())


def test_a_grid_in_water_needs_its_place():
    scene = camera(tanks=[TANK])
    with pytest.raises(
        LfmeshError, match=r'meets the grid outside all bodies: .* inside, one of "tanks\[0\] wall", "tanks\[0\] liq'
    ):
        projection_matrix(scene, box(position_mm=(0.0, 0.0, -58.0), size=(2.0, 2.0, 2.0)))
    with pytest.raises(LfmeshError, match=r'inside = "water": no body'):
        projection_matrix(scene, box(), inside="water")


def test_a_matrix_larger_than_the_memory_or_the_disk_is_refused_first(tmp_path, monkeypatch):
    monkeypatch.setattr("lfmesh.scene.memory.physical_memory_bytes", lambda: 1e3)
    with pytest.raises(LfmeshError, match="more than this machine's memory; stream it"):
        projection_matrix(camera(), box())
    monkeypatch.setattr("shutil.disk_usage", lambda _: type("Usage", (), {"free": 1000})())
    with pytest.raises(FileError, match="GB are free"):
        lf.write_projection_matrix(camera(), box(), tmp_path / "m.npz")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("ending", ["npz", "h5"])
def test_a_matrix_warns_of_light_that_it_lacks_as_an_image_does(ending, tmp_path, monkeypatch):
    """In Python and in its file; the warning is that of all its blocks, of those that an earlier run had made, too."""
    monkeypatch.setattr("lfmesh.lightfield.volumes.projector.RAYS_AT_ONCE", 1 << 8)
    # Half of the view is behind glass, whose faces are two events more.
    block = {"refractor": {"index": 1.5, "box_mm": [30.0, 30.0, 3.0]}, "position_mm": [15.3, 0.0, -40.0]}
    scene = camera((block,), max_events=4)
    with pytest.warns(lf.CutPathsWarning) as told:
        made = projection_matrix(scene, box())
    assert made.warnings == (told[0].message,)
    usual, done = files.staged_file, []

    def cut_short(folder, name):
        if len(done) == 3:
            raise KeyboardInterrupt
        done.append(name)
        return usual(folder, name)

    path = tmp_path / f"m.{ending}"
    monkeypatch.setattr(files, "staged_file", cut_short)
    with pytest.raises(KeyboardInterrupt):
        files.write_projection_matrix(scene, box(), path)
    monkeypatch.setattr(files, "staged_file", usual)
    with pytest.warns(lf.CutPathsWarning) as told:
        files.write_projection_matrix(scene, box(), path)
    assert (told[0].message,) == files.open_projection_matrix(path).warnings == made.warnings
    assert projection_matrix(scene.changed({"transport.max_events": 6}), box()).warnings == ()


def test_a_damaged_file_is_refused(tmp_path):
    path = tmp_path / "m.npz"
    path.write_bytes(b"nothing")
    with pytest.raises(FileError, match="not a projection matrix, or is damaged"):
        files.open_projection_matrix(path)


@pytest.mark.long
def test_the_example_of_the_page_prints_what_it_says(capsys, monkeypatch):
    page = (ROOT / "lfmesh" / "lightfield" / "README.md").read_text(encoding="utf-8")
    script = next(block for block in re.findall(r"^```python\n(.*?)^```$", page, re.M | re.S) if "reconstruct" in block)
    monkeypatch.chdir(ROOT)
    exec(compile(script, "README.md", "exec"), {})
    lines = capsys.readouterr().out.strip().splitlines()
    assert len(lines) == 2
    for line in lines:
        assert f"`{line}`" in page


def test_the_command_writes_a_matrix_and_says_its_size(tmp_path, capsys):
    scene, out = tmp_path / "scene.toml", tmp_path / "m.npz"
    scene.write_text(camera().dump_toml())
    place = ["--counts", "5", "4", "6", "--size-mm", "9", "8", "14", "--position-mm", "0.4", "-0.3", "-60"]
    turned = [*place, "--rotation-deg", "20", "-35", "50", "--samples", "8"]
    assert main(["matrix", str(scene), *turned, "-o", str(out)]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "256 pixels × 120 voxels: about" in printed
    assert "of their sum dropped" in printed
    made = lf.open_projection_matrix(out)
    assert resolution_messages.resolution_message(made) in printed
    assert f"effective rank {made.effective_rank} of 120 voxels" in printed
    assert (made.resolved_mm >= made.grid.spacing_mm).all()
    np.testing.assert_array_equal(made.matrix.toarray(), projection_matrix(camera(), box()).matrix.toarray())
    # A grid in a file, whose middle is its origin.
    np.savez(tmp_path / "grid.npz", emission_w_mm3_sr=np.ones((5, 4, 6)), spacing_mm=np.array([1.8, 2.0, 14.0 / 6.0]))
    from_file = ["--grid", str(tmp_path / "grid.npz"), *turned[8:]]
    assert main(["matrix", str(scene), *from_file, "-o", str(out)]) == 0
    np.testing.assert_allclose(lf.open_projection_matrix(out).matrix.data, made.matrix.data, rtol=1e-9)
    assert main(["matrix", str(scene), "-o", str(out)]) == 2
    assert "--counts and --size-mm" in capsys.readouterr().err

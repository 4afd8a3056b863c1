"""The film: independent of threads and chunks, honest about its error, kept when a run is cut short."""

import warnings
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from lfmesh.errors import LfmeshError
from lfmesh.transport import engine
from lfmesh.transport.render.render import Renderer
from tests.cameras import close_up_camera
from tests.renders import by_seed

LEVEL = 1e-3
"""Chance that a statistical test fails though the law holds."""

SCENE: dict[str, Any] = {
    "camera": close_up_camera(20, 16),
    "targets": [
        {"shape": {"kind": "plane", "width_mm": 7.0, "height_mm": 6.0}, "position_mm": [0, 0, -60.0],
         "material": {"reflectance": 0.8, "radiance_w_m2_sr": 100.0}},
        {"shape": {"kind": "box", "size_mm": [1.2, 1.0, 1.5]}, "position_mm": [1.0, -1.0, -56.0],
         "rotation_deg": [20.0, 10.0, 30.0], "material": {"reflectance": 0.5}},
    ],
    "lights": [{"kind": "disk", "position_mm": [20.0, -15.0, -25.0], "direction": [-20.0, 15.0, -35.0],
                "radius_mm": 3.0, "power_w": 1.0}],
    "transport": {"samples": 64, "replicates": 8, "threads": 1},
}  # fmt: skip


def scene(**transport: Any) -> lf.Scene:
    """A box before a glowing plane under a lamp, seen by 4 x 4 lenslets."""
    return lf.Scene(**SCENE | {"transport": SCENE["transport"] | transport})


def sums(**transport: Any) -> NDArray[np.float64]:
    """Return the images' sums of 16 seeds from 0, (16, wavelengths)."""
    images = by_seed(scene(**transport, replicates=1), range(16))
    return np.array([image.mean.sum(axis=(0, 1)) for image in images])


@pytest.mark.parametrize("method", ["adjoint", "forward"])
def test_the_number_of_threads_does_not_change_a_bit(method: str) -> None:
    one, two = (
        Renderer(lf.build(scene(method=method, split="both", threads=threads)), chunk=1000).image()
        for threads in (1, 2)
    )
    assert one.mean.any()
    np.testing.assert_array_equal(one.mean, two.mean)
    np.testing.assert_array_equal(one.stderr, two.stderr)
    assert one.ledger == two.ledger


@pytest.mark.parametrize("method", ["adjoint", "forward"])
@pytest.mark.parametrize("split", ["transmit", "both", "roulette"])
def test_chunk_size_changes_nothing_but_rounding(method: str, split: str) -> None:
    world = lf.build(scene(method=method, split=split))
    large = Renderer(world).image()
    for chunk in (64, 777):
        small = Renderer(world, chunk=chunk).image()
        # Sums of the same terms in another order.
        np.testing.assert_allclose(small.mean, large.mean, rtol=1e-12, atol=1e-15 * large.mean.max())
        np.testing.assert_allclose(small.stderr, large.stderr, rtol=1e-9, atol=1e-12 * large.mean.max())
        assert small.ledger.events == large.ledger.events


@pytest.mark.parametrize("method", ["adjoint", "forward"])
def test_the_same_seed_gives_the_same_image_and_another_seed_other_noise(method: str) -> None:
    first = lf.render(scene(method=method))
    np.testing.assert_array_equal(first.mean, lf.render(scene(method=method)).mean)
    other = lf.render(scene(method=method, seed=1))
    lit = first.mean > 0.0
    assert (first.mean[lit] != other.mean[lit]).mean() > 0.99
    # One mean: Welch's t-test of the sums of seeds 0 to 7 and 8 to 15.
    totals = [image.mean.sum() for image in by_seed(scene(method=method, replicates=1), range(16))]
    assert len(set(totals)) == 16
    assert stats.ttest_ind(totals[:8], totals[8:], equal_var=False).pvalue > LEVEL


@pytest.mark.parametrize("seed", range(8))
def test_any_seed_renders(seed: int) -> None:
    """Keys of 64 bits lie on either side of 2⁶³ by the seed's chance."""
    assert lf.render(scene(seed=seed, samples=2, replicates=2)).mean.any()


def test_replicates_differ() -> None:
    image = lf.render(scene())
    assert (image.stderr[image.mean > 0.0] > 0.0).all()


@pytest.mark.parametrize("method", ["adjoint", "forward"])
def test_stderr_is_the_spread_of_means(method: str) -> None:
    """Over 40 seeds the squared stderr estimates the variance of `mean`, without bias.

    Both are unbiased for one variance; per strip of the image their difference is tested by its own spread over pixels
    (adjoint: independent pixels) with a t-test: sample variance over seeds minus mean squared stderr, pixel by pixel,
    in units of the latter.
    """
    images = list(by_seed(scene(method=method, samples=16, replicates=4), range(40)))
    means = np.array([image.mean[..., 0] for image in images])
    claimed = np.mean([image.stderr[..., 0] ** 2 for image in images], axis=0)
    found = means.var(axis=0, ddof=1)
    bright = means.mean(axis=0) > 0.25 * means.mean()
    excess = ((found - claimed) / claimed)[bright]
    assert bright.sum() > 100
    # The test can see a stderr that is 10 % off, which makes the variance some 20 % so.
    assert stats.sem(excess) < 0.04
    assert stats.ttest_1samp(excess, 0.0).pvalue > LEVEL


@pytest.mark.parametrize("method", ["adjoint", "forward"])
def test_stderr_falls_with_the_root_of_samples_or_faster(method: str) -> None:
    """Eight times the samples: 1/8 of the variance; log ratio of image means over 12 seeds, one-sample t-test.

    Forward, whose samples are independent, exactly so; adjoint starts from Sobol' points, whose strata make the
    variance fall faster, and from random ones exactly so again. Without the array, whose rare heavy samples would drown
    a sum of squares.
    """

    worlds = [lf.build(scene(method=method, samples=n).changed({"camera.mla": None})) for n in (16, 128)]
    for world in worlds:
        # Found before the seeds are changed, the sequences of ghosts are there for all of them.
        _ = world.ghosts

    def ratio(stratified: bool, k: int) -> float:
        few, many = (
            Renderer(world.reseeded(2 * k + number), check=False, stratified=stratified).image()
            for number, world in enumerate(worlds)
        )
        return float(np.log((few.stderr**2).sum() / (many.stderr**2).sum()))

    independent = [ratio(False, k) for k in range(12)]
    assert stats.sem(independent) < 0.1
    assert stats.ttest_1samp(independent, np.log(8.0)).pvalue > LEVEL
    if method == "adjoint":
        stratified = [ratio(True, k) for k in range(12)]
        assert stats.ttest_1samp(stratified, np.log(8.0), alternative="greater").pvalue < LEVEL


def test_one_replicate_has_no_stderr() -> None:
    image = lf.render(scene(replicates=1))
    assert np.isnan(image.stderr).all()
    assert np.isfinite(image.mean).all()


def test_ctrl_c_keeps_the_finished_replicates(monkeypatch: pytest.MonkeyPatch) -> None:
    """Their mean is that of the same replicates rendered alone, to the bit."""
    monkeypatch.setattr("lfmesh.transport.render.render.PROGRESS_SECONDS", 0.0)

    def interrupt(progress: lf.Progress) -> None:
        if progress.replicate == 3:
            raise KeyboardInterrupt

    image = lf.render(scene(), interrupt)
    assert not image.complete
    assert lf.InterruptedRenderWarning in map(type, image.warnings)
    assert image.replicates == 3
    assert image.samples == 3 * 64 / 8
    # Eight samples each, so three of eight replicates are the three of a run of 24 samples.
    alone = lf.render(scene(samples=24, replicates=3))
    assert alone.complete
    np.testing.assert_array_equal(image.mean, alone.mean)
    np.testing.assert_array_equal(image.stderr, alone.stderr)
    np.testing.assert_array_equal(image.hits, alone.hits)
    assert image.ledger.emitted == alone.ledger.emitted
    assert image.ledger.packets == alone.ledger.packets
    assert abs(image.ledger.imbalance) <= 1e-12


def test_ctrl_c_before_the_first_replicate_is_done_raises(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfmesh.transport.render.render.PROGRESS_SECONDS", 0.0)

    def interrupt(progress: lf.Progress) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        lf.render(scene(), interrupt)


def test_progress_counts_up_to_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfmesh.transport.render.render.PROGRESS_SECONDS", 0.0)
    reports: list[lf.Progress] = []
    lf.render(scene(wavelengths_nm=[500.0, 600.0]), reports.append)
    done = [report.done for report in reports]
    assert done == sorted(done)
    # Paths with reflections get a quarter of the samples of the image path.
    assert done[-1] == reports[-1].total == 20 * 16 * (64 + 16) * 2
    assert {report.replicate for report in reports} == set(range(8))


@pytest.mark.parametrize("method", ["adjoint", "forward"])
def test_each_wavelength_is_an_image_of_its_own(method: str) -> None:
    """Channel i is what a render at that wavelength alone gives (Welch's t-test, Bonferroni); noise is not shared."""
    waves = [486.1, 587.6, 656.3]
    dispersive = {"camera.lens.surfaces[0].index": None, "camera.lens.surfaces[0].glass": "SCHOTT/SF11",
                  "camera.mla.distance_mm": 18.0, "camera.sensor.distance_mm": 2.2}  # fmt: skip

    def total(waves: list[float], first: int) -> NDArray[np.float64]:
        here = scene(method=method, samples=16, replicates=1, wavelengths_nm=waves).changed(dispersive)
        return np.array([image.mean.sum(axis=(0, 1)) for image in by_seed(here, range(first, first + 16))])

    together = total(waves, 0)
    assert together.shape == (16, 3)
    p = [
        stats.ttest_ind(together[:, i], total([wave], 1000 * (i + 1))[:, 0], equal_var=False).pvalue
        for i, wave in enumerate(waves)
    ]
    assert min(p) > LEVEL / 3
    assert (together[:, 0] != together[:, 1]).all()


@pytest.mark.parametrize("method", ["adjoint", "forward"])
def test_grey_is_grey_at_every_wavelength(method: str) -> None:
    """Without dispersion all channels have one mean: paired t-tests of their sums, Bonferroni."""
    together = sums(method=method, samples=16, wavelengths_nm=[450.0, 550.0, 650.0])
    p = [stats.ttest_rel(together[:, a], together[:, b]).pvalue for a, b in ((0, 1), (0, 2), (1, 2))]
    assert min(p) > LEVEL / len(p)


@pytest.mark.parametrize("method", ["adjoint", "forward"])
def test_rigid_motion_of_the_whole_world_changes_nothing_but_rounding(method: str) -> None:
    """The same random numbers send the same packets: all pixels agree but where rounding tips a packet over an edge."""
    shift = [1200.0, -340.0, 560.0]
    pose = {"camera.pose.shift_mm": shift}
    places = {
        "targets[0].position_mm": np.add(shift, [0.0, 0.0, -60.0]).tolist(),
        "targets[1].position_mm": np.add(shift, [1.0, -1.0, -56.0]).tolist(),
        "lights[0].position_mm": np.add(shift, [20.0, -15.0, -25.0]).tolist(),
    }
    # A turn by 90 degrees about y takes (x, y, z) to (z, y, −x); the plane turns with it and the box is left out.
    turn = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    here = scene(method=method, split="both")
    reference = lf.render(here)
    assert_same_but_for_flips(lf.render(here.changed({**pose, **places})).mean, reference.mean)

    alone = here.changed({"targets": SCENE["targets"][:1]})
    turned = alone.changed(
        {
            "camera.pose.tilt_deg": [0.0, 90.0, 0.0],
            "targets[0].position_mm": (turn @ [0, 0, -60.0]).tolist(),
            "targets[0].rotation_deg": [0.0, 90.0, 0.0],
            "lights[0].position_mm": (turn @ [20.0, -15.0, -25.0]).tolist(),
            "lights[0].direction": (turn @ [-20.0, 15.0, -35.0]).tolist(),
        }
    )
    if method == "adjoint":
        # Scattered directions and points of a lamp's disk are drawn in axes that do not turn: the lamp becomes a point.
        lamp = {"lights[0].radius_mm": 1e-6}
        reference, moved = lf.render(alone.changed(lamp)), lf.render(turned.changed(lamp))
        assert_same_but_for_flips(moved.mean, reference.mean)
    one = [image.mean.sum() for image in by_seed(alone, range(16))]
    other = [image.mean.sum() for image in by_seed(turned, range(100, 116))]
    assert stats.ttest_ind(one, other, equal_var=False).pvalue > LEVEL


def assert_same_but_for_flips(moved: NDArray[np.float64], still: NDArray[np.float64]) -> None:
    """Compare images pixel by pixel; one pixel in a hundred may hold a packet that rounding tipped over an edge."""
    differs = np.abs(moved - still) > 1e-6 * np.maximum(still, 1e-3 * still.max())
    assert differs.mean() <= 0.01


@pytest.mark.parametrize("method", ["adjoint", "forward"])
def test_hits_do_not_depend_on_threads_and_chunks_and_say_where_there_is_light(method: str) -> None:
    one, *others = (
        Renderer(lf.build(scene(method=method, samples=16, threads=threads)), chunk=chunk).image()
        for threads, chunk in ((1, 1000), (2, 1000), (1, 64))
    )
    assert one.hits is not None
    assert (one.hits > 0).any()
    np.testing.assert_array_equal(one.hits > 0, one.mean > 0.0)
    for other in others:
        np.testing.assert_array_equal(one.hits, other.hits)


def test_a_sample_that_brings_light_in_several_ways_is_one_hit() -> None:
    """Two more lamps light the same paths, and every path that meets the glowing plane has brought light already."""
    plain = scene(split="transmit", samples=16).changed({"targets": SCENE["targets"][:1]})
    lamps = [{**SCENE["lights"][0], "position_mm": [x, 0.0, 0.0], "direction": [-x, 0.0, -60.0]} for x in (9.0, -9.0)]
    several = plain.changed({"lights": [*SCENE["lights"], *lamps]})
    one, three = lf.render(plain), lf.render(several)
    assert (three.mean > 1.05 * one.mean)[one.mean > 0.0].mean() > 0.5
    np.testing.assert_array_equal(one.hits, three.hits)
    assert one.hits is not None
    assert one.hits.max() == 16


def test_reflections_have_samples_of_their_own_which_split_as_often_as_they_will() -> None:
    image = lf.render(scene(split="both", samples=16, weight_cutoff=0.0, max_events=20))
    alone = lf.render(scene(split="both", samples=16, weight_cutoff=0.0, max_events=20, engine="mesh"))
    assert image.hits is not None
    assert alone.hits is not None
    # 16 of the image path, and for two of these one of the lens's ghosts and one of other strays.
    assert 16 < image.hits.max() <= 32
    assert alone.hits.max() == 16


def test_samples_that_replicates_cannot_share_are_rounded_up() -> None:
    asked, rounded = (lf.render(scene(split="transmit", samples=n, replicates=4)) for n in (13, 16))
    np.testing.assert_array_equal(asked.mean, rounded.mean)
    assert asked.samples == 16


def test_trees_of_reflections_without_an_end_are_refused_in_a_render(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine, "MOST_EVENTS_EACH", 300)
    lf.render(scene(split="both", samples=1, replicates=1, engine="mesh"))
    with pytest.raises(LfmeshError, match=r"300 events each, .* raise weight_cutoff above 0, or lower max_events"):
        lf.render(scene(split="both", samples=1, replicates=1, weight_cutoff=0.0, max_events=64, engine="mesh"))


@pytest.mark.parametrize("split", ["transmit", "both"])
def test_a_pixel_may_have_more_samples_than_a_chunk(split: str) -> None:
    world = lf.build(scene(samples=512, replicates=2, split=split).changed({"camera.sensor.pixels": (4, 4)}))
    small, large = Renderer(world, chunk=16).image(), Renderer(world).image()
    np.testing.assert_allclose(small.mean, large.mean, rtol=1e-12, atol=1e-15 * large.mean.max())
    np.testing.assert_array_equal(small.hits, large.hits)


@pytest.mark.parametrize("method", ["forward", "adjoint"])
def test_fog_that_the_forward_method_finds_too_seldom_is_warned_of(method: str) -> None:
    """Its light comes from right before the lens: a law of the method, not of the number of packets."""
    fog = {"scattering_per_mm": 1e-3}
    given = scene(method=method, samples=2, replicates=2, split="transmit").changed({"media": [fog]})
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        lf.render(given)
    missed = [str(each.message) for each in caught if issubclass(each.category, lf.MissedLightWarning)]
    assert len(missed) == (method == "forward")
    assert all(line.startswith("media[0] scatters light right before the lens") for line in missed)

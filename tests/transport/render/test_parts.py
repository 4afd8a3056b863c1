"""The image path and what is off it, estimated apart, make the picture that the mesh engine makes in one.

The glass is dense and the glowing plane wide, so that reflections bring much light: to count it twice, or not at all,
is seen.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from lfmesh.transport.render.parts import parts_of
from tests.cameras import SQUARE_ARRAY, biconvex
from tests.renders import by_seed

LEVEL = 1e-3
"""Chance that a scene fails though both ways are right; shared by its comparisons (Bonferroni)."""

REPLICATES = 24
SQUARE = 5

LENS = biconvex(48.0, index=2.2)
ARRAY = SQUARE_ARRAY | {"index": 2.2}
PLANE = {
    # Far beyond the field of view: ghosts bring light from everywhere.
    "shape": {"kind": "plane", "width_mm": 200.0, "height_mm": 200.0},
    "position_mm": (0.0, 0.0, -60.0),
    "material": {"reflectance": 0.5, "radiance_w_m2_sr": 1.0},
}
GLASS_BALL = "glass ball"


def scene(**changes: Any) -> lf.Scene:
    given = lf.Scene(
        camera={"focus_mm": 60.0, "lens": LENS, "mla": ARRAY, "sensor": {"pixels": (20, 20), "pixel_mm": 0.1}},
        targets=[PLANE],
        transport={"split": "both", "samples": 8 * REPLICATES, "replicates": REPLICATES, "threads": 1},
    )
    return given.changed(changes)


def squares(image: lf.Image) -> NDArray[np.float64]:
    """Return the sums over squares of pixels, and of the whole."""
    height, width, _ = image.mean.shape
    parts = image.mean.reshape(height // SQUARE, SQUARE, width // SQUARE, SQUARE).sum(axis=(1, 3)).ravel()
    return np.append(parts, parts.sum())


def replicates(given: lf.Scene) -> NDArray[np.float64]:
    """Return the sums of single replicates, (REPLICATES, sums)."""
    one = given.changed({"transport.samples": 8, "transport.replicates": 1})
    return np.stack([squares(image) for image in by_seed(one, range(REPLICATES))])


@pytest.mark.parametrize(
    "changes",
    [
        pytest.param({}, marks=pytest.mark.long),
        {"camera.mla.layout": "hexagonal", "camera.mla.curved_side": "sensor"},
        {"camera.mla": None},
        {"targets": GLASS_BALL},
        {"transport.split": "roulette"},
    ],
    ids=["square", "hexagonal", "conventional", "glass ball", "by chance"],
)
def test_the_parts_make_the_picture_of_the_mesh_engine(changes: dict[str, Any], tmp_path: Path) -> None:
    if changes.get("targets") == GLASS_BALL:
        trimesh.creation.icosphere(2, 1.5).export(tmp_path / "ball.stl")
        glass = {"file": (tmp_path / "ball.stl").as_posix(), "units": "mm", "index": 2.0}
        changes = {"targets": [PLANE, {"refractor": glass, "position_mm": (0.3, 0.2, -50.0)}]}
    given = scene(**changes)
    assert len(parts_of(lf.build(given))) == 3
    apart = replicates(given)
    whole = replicates(given.changed({"transport.engine": "mesh", "transport.weight_cutoff": 0.1}))
    image_path = squares(lf.render(given.changed({"transport.split": "transmit"})))
    assert apart[:, -1].mean() > 1.015 * image_path[-1], "without reflections to speak of nothing is tested"
    p = stats.ttest_ind(apart, whole, equal_var=False).pvalue
    assert p[np.isfinite(p)].min() > LEVEL / len(p), (apart.mean(axis=0) / whole.mean(axis=0), p)


def test_the_ledger_is_that_of_all_paths() -> None:
    """Means over six seeds, by a t-test: what a single run emits depends on where its few rays that go anywhere go."""
    apart = [lf.render(scene(**{"transport.seed": seed})).ledger for seed in range(6)]
    mesh = {"transport.engine": "mesh"}
    whole = [lf.render(scene(**mesh, **{"transport.seed": seed})).ledger for seed in range(6, 12)]
    assert max(abs(ledger.imbalance) for ledger in apart) < 1e-12
    for name in ("emitted", "reached_target", "lit"):
        one, other = (np.array([getattr(ledger, name) for ledger in ledgers]) for ledgers in (apart, whole))
        assert stats.ttest_ind(one, other, equal_var=False).pvalue > LEVEL, name
        # Which sees less than what reflections bring.
        assert np.hypot(one.std(), other.std()) / np.sqrt(6.0) < 0.015 * other.mean(), name


@pytest.mark.parametrize("changes", [{}, {"transport.target_error": 0.05, "transport.max_samples": 64}])
def test_threads_do_not_change_a_bit(changes: dict[str, Any]) -> None:
    few = scene(**{"transport.samples": 8, "transport.replicates": 2, **changes})
    one, two = (lf.render(few.changed({"transport.threads": threads})) for threads in (1, 2))
    np.testing.assert_array_equal(one.mean, two.mean)
    np.testing.assert_array_equal(one.stderr, two.stderr)


PAINTED = {
    "shape": {"kind": "plane", "width_mm": 20.0, "height_mm": 20.0},
    "position_mm": (0.0, 0.0, -60.0),
    "material": {"reflectance": 0.8},
}
LAMP = {"kind": "point", "position_mm": (8.0, 0.0, -40.0), "power_w": 1.0}


@pytest.fixture(scope="module")
def lamp_behind_glass(tmp_path_factory: pytest.TempPathFactory) -> lf.Scene:
    """A screen that one lamp lights through a pane beside it, and another straight on."""
    folder = tmp_path_factory.mktemp("pane")
    trimesh.creation.box((1.0, 30.0, 30.0)).export(folder / "pane.stl")
    pane = {"refractor": {"file": "pane.stl", "units": "mm", "index": 1.5}, "position_mm": (5.5, 0.0, -44.0)}
    return lf.Scene(
        camera={"focus_mm": 60.0, "lens": LENS, "sensor": {"pixels": (4, 4), "pixel_mm": 0.5}},
        targets=[PAINTED, pane],
        lights=[LAMP, LAMP | {"position_mm": (-20.0, 0.0, -40.0), "power_w": 5.0}],
        transport={"samples": 1024, "replicates": 8, "threads": 1},
    ).in_folder(folder)


def test_lamps_have_a_part_where_their_light_meets_glass_and_targets_scatter_it(lamp_behind_glass: lf.Scene) -> None:
    assert [part.options.adjoint for part in parts_of(lf.build(lamp_behind_glass))] == [True, True, True, False]
    for changes in (
        {"lights": []},
        {"targets": [PAINTED]},
        {"targets[0].material.reflectance": 0.0},
        {"transport.method": "forward"},
    ):
        others = parts_of(lf.build(lamp_behind_glass.changed(changes)))
        assert [part.options.adjoint for part in others] in ([True, True, True], [False])


def test_the_books_of_what_lamps_send_close(lamp_behind_glass: lf.Scene, tmp_path: Path) -> None:
    image = lf.render(lamp_behind_glass)
    assert image.engine.endswith("lamps' light through glass forward")
    lamps = image.ledger.lamps
    assert lamps is not None
    assert abs(image.ledger.imbalance) < 1e-12
    assert abs(lamps.imbalance) < 1e-12
    assert lamps.emitted == pytest.approx(6.0, rel=0.05)
    # The sensor's own paths are booked in m² sr, the lamps' in W.
    assert (image.ledger.unit, lamps.unit) == ("m² sr", "W")
    assert 0.0 < lamps.sensor < image.mean.sum()
    lf.save(image, tmp_path / "run")
    assert lf.open_run(tmp_path / "run").ledger == image.ledger


ADAPTIVE = {"transport.target_error": 0.0005, "transport.max_samples": 8192}


def test_adaptive_sampling_leaves_what_lamps_send_as_it_is(lamp_behind_glass: lf.Scene) -> None:
    """Added to the second stage too, or weighted with the pixels' samples, it would be brighter or dimmer."""
    refined, plain = (
        list(by_seed(lamp_behind_glass.changed(changes), range(first, first + 12)))
        for changes, first in ((ADAPTIVE, 0), ({}, 100))
    )
    assert all(image.refinement is not None and image.refinement.refined_share > 0.5 for image in refined)
    sums = [[image.mean.sum() for image in images] for images in (refined, plain)]
    assert stats.ttest_ind(*sums, equal_var=False).pvalue > LEVEL
    assert refined[0].ledger.lamps is not None
    assert refined[0].ledger.lamps.sensor > 0.1 * refined[0].mean.sum()
    # The error bars are those of the sums' spread, within what 12 sums and correlated pixels let one know.
    told = np.sqrt(np.mean([(image.stderr**2).sum() for image in refined]))
    assert 0.5 < np.std(sums[0], ddof=1) / told < 2.0


def test_ctrl_c_keeps_what_lamps_sent_in_the_finished_replicates(
    lamp_behind_glass: lf.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lfmesh.transport.render.render.PROGRESS_SECONDS", 0.0)

    def interrupt(progress: lf.Progress) -> None:
        if progress.replicate == 3:
            raise KeyboardInterrupt

    image = lf.render(lamp_behind_glass.changed(ADAPTIVE), interrupt)
    assert image.replicates == 3
    alone = lf.render(lamp_behind_glass.changed({"transport.samples": 3 * 128, "transport.replicates": 3}))
    np.testing.assert_allclose(image.mean, alone.mean, rtol=1e-12)


@pytest.mark.parametrize("changes", [{}, ADAPTIVE])
def test_threads_do_not_change_a_bit_of_what_lamps_send(changes: dict[str, Any], lamp_behind_glass: lf.Scene) -> None:
    one, two = (lf.render(lamp_behind_glass.changed({**changes, "transport.threads": n})) for n in (1, 2))
    np.testing.assert_array_equal(one.mean, two.mean)
    np.testing.assert_array_equal(one.stderr, two.stderr)

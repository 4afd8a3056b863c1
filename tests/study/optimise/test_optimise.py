"""`lf.optimise` finds what closed forms say, keeps limits, picks glasses, and says what is not reached."""

import itertools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.study.optimise.design_file import DesignFile, Term, Variable
from lfmesh.study.optimise.optimise import best_of, load_design
from lfmesh.study.optimise.problem import Place, Problem, Rated
from lfmesh.study.optimise.renders import Renders
from lfmesh.wrapping import COLUMNS
from tests.study.optimise.designs import (
    PUBLISHED_SENSOR_MM,
    TRIPLET_MM,
    camera,
    detuned,
    lens_variables,
)
from tests.study.studies import SHIFT, small_scene

DESIGNS = Path(__file__).resolve().parents[3] / "assets" / "designs"
RADIUS, THICKNESS = "camera.lens.surfaces[0].radius_mm", "camera.lens.surfaces[0].thickness_mm"
INDEX = 1.6


def plano_convex(radius_mm: float = 40.0, thickness_mm: float = 3.0) -> lf.Scene:
    """A plano-convex lens, whose focal length is R / (n - 1) whatever its thickness is."""
    front = {
        "radius_mm": radius_mm,
        "thickness_mm": thickness_mm,
        "index": INDEX,
        "semi_diameter_mm": 5.0,
        "stop": True,
    }
    return lf.Scene(
        camera={
            "focus_mm": 1000.0,
            "lens": {"surfaces": [front, {"semi_diameter_mm": 5.0}]},
            "sensor": {"pixels": [100, 100], "pixel_mm": 0.05},
        }
    )


def focal_length(target: float) -> list[dict[str, Any]]:
    return [{"metric": "efl_mm", "target": target}]


def test_a_focal_length_is_met_by_the_radius_of_its_formula() -> None:
    found = lf.optimise(plano_convex(), [{"path": RADIUS, "range": [20.0, 90.0]}], focal_length(80.0))
    assert found.scene.camera.lens.surfaces[0].radius_mm == pytest.approx((INDEX - 1.0) * 80.0, rel=1e-9)
    assert found.merit_after < 1e-12 < found.merit_before
    assert not found.missed
    assert found.first == plano_convex()


@pytest.mark.parametrize("search", [{"starts": 50}, {"method": "global"}])
def test_a_search_ends_where_only_rounding_is_left_of_the_merit(search: dict[str, Any]) -> None:
    """The first start meets the target, and no other is tried; least squares alone would go on to their own ends."""
    variables = [{"path": RADIUS, "range": [20.0, 90.0]}]
    found = lf.optimise(plano_convex(), variables, focal_length(80.0), search=search)
    assert found.scene.camera.lens.surfaces[0].radius_mm == pytest.approx((INDEX - 1.0) * 80.0, rel=2e-9)
    assert found.merit_after <= 1e-18 * 80.0**2
    assert found.merit_left == 0.0
    assert found.starts <= 1
    met = lf.optimise(found.scene, variables, focal_length(80.0), search=search)
    assert met.evaluations < 5
    assert met.first == met.scene == found.scene


def test_a_term_that_is_met_is_no_end_of_the_search_for_a_lighter_one() -> None:
    """What is left may be less than 1e-18 of the merit at first: each term is judged by its own."""
    variables = [Variable(path=RADIUS, range=(20.0, 90.0)), Variable(path=THICKNESS, range=(1.0, 6.0))]
    heavy = Term(metric="efl_mm", target=80.0, weight=1e10)
    light = Term(metric="centre_thickness_mm", target=4.0)
    problem = Problem(DesignFile(scene="scene", variables=variables, merit=(heavy, light)), plano_convex())

    def rated(radius_mm: float, thickness_mm: float) -> Rated:
        values = zip(problem.knobs, (radius_mm, thickness_mm), strict=True)
        return problem.rated(Place(np.array([knob.place(value) for knob, value in values]), ()))

    first, one, both = (rated(*values) for values in ((40.0, 3.0), (48.0, 3.0), (48.0, 4.0)))
    assert problem.merit(one) < 1e-18 * problem.merit(first)
    assert [problem.is_exact(each, first) for each in (first, one, both)] == [False, False, True]


def test_the_focal_length_of_one_type_of_lenslet_varies_by_its_bare_name_as_in_a_study() -> None:
    path, scene = "camera.mla.focal_length_mm", small_scene()
    assert scene.camera.mla is not None
    (focal_length_mm,) = scene.camera.mla.focal_length_mm or ()
    variable = {"path": path, "range": (0.5 * focal_length_mm, 2.0 * focal_length_mm)}
    design: dict[str, Any] = {"scene": "scene", "merit": focal_length(80.0)}
    problem = Problem(DesignFile(variables=[variable], **design), scene)
    assert problem.values_at(problem.start) == {f"{path}[0]": focal_length_mm}
    (knob,) = problem.knobs
    there = problem.scene_at(Place(np.array([knob.place(1.5 * focal_length_mm)]), ()))
    assert there.camera.mla is not None
    assert there.camera.mla.focal_length_mm == (pytest.approx(1.5 * focal_length_mm),)
    with pytest.raises(lf.LfmeshError, match="is a variable already"):
        Problem(DesignFile(variables=[variable, {**variable, "path": f"{path}[0]"}], **design), scene)


@pytest.mark.parametrize("target", [40.0, 90.0])
def test_a_flat_face_becomes_convex_or_hollow_as_the_lensmakers_formula_says(target: float) -> None:
    found = lf.optimise(
        plano_convex(), [{"path": "camera.lens.surfaces[1].radius_mm", "range": [-30.0, 30.0]}], focal_length(target)
    )
    front, n = 1.0 / 40.0, INDEX
    back = (front - 1.0 / (target * (n - 1.0))) / (1.0 - (n - 1.0) * 3.0 * front / n)
    assert found.scene.camera.lens.surfaces[1].radius_mm == pytest.approx(1.0 / back, rel=1e-8)


def test_a_target_out_of_range_is_not_reached_and_the_bound_is_named() -> None:
    found = lf.optimise(plano_convex(), [{"path": RADIUS, "range": [35.0, 60.0]}], focal_length(150.0))
    (variable,) = found.variables
    assert variable.note == "at the end of its range, 60"
    assert variable.after == pytest.approx(60.0, rel=1e-3)
    assert len(found.missed) == 1
    assert "efl_mm" in found.missed[0]
    assert "target 150" in found.missed[0]


@pytest.mark.parametrize(("limit", "wanted", "best"), [({"most": 4.0}, 8.0, 4.0), ({"least": 5.0}, 2.0, 5.0)])
def test_a_limit_is_kept_and_the_best_camera_lies_on_it(limit: dict[str, float], wanted: float, best: float) -> None:
    found = lf.optimise(
        plano_convex(),
        [{"path": THICKNESS, "range": [1.0, 10.0]}],
        [{"metric": "total_length_mm", "target": 69.0 + wanted}],
        constraints=[{"metric": "centre_thickness_mm", **limit}],
    )
    assert found.scene.camera.lens.surfaces[0].thickness_mm == pytest.approx(best, rel=2e-6)
    assert not found.constraints[0].missed
    assert "total_length_mm" in " ".join(found.missed)


def test_a_limit_that_no_camera_keeps_is_said_to_be_violated() -> None:
    found = lf.optimise(
        plano_convex(),
        [{"path": THICKNESS, "range": [1.0, 10.0]}],
        focal_length(66.0),
        constraints=[{"metric": "centre_thickness_mm", "least": 12.0}],
    )
    assert found.constraints[0].share_after == pytest.approx(2.0 / 12.0, rel=1e-6)
    assert "violates at least 12" in found.constraints[0].missed
    assert "violates at least 12" in str(found)


@pytest.mark.parametrize("method", ["local", "global"])
def test_a_search_ends_early_where_limits_exclude_each_other_and_names_the_nearest_values(method: str) -> None:
    """A lens of 4 mm at most whose length is to be 75 mm at least, with its sensor 65 mm behind it."""
    scene = plano_convex().changed({"camera.sensor.distance_mm": 65.0})
    limits = [{"metric": "centre_thickness_mm", "most": 4.0}, {"metric": "total_length_mm", "least": 75.0}]
    found = lf.optimise(
        scene, [{"path": THICKNESS, "range": [1.0, 12.0]}], [{"metric": "total_length_mm", "target": 66.0}],
        constraints=limits, search={"method": method, "evaluations": 60},
    )  # fmt: skip
    # Least squares of (t − 4)/4 and (10 − t)/75.
    nearest = (4.0 / 4.0**2 + 10.0 / 75.0**2) / (1.0 / 4.0**2 + 1.0 / 75.0**2)
    told = [note for note in found.notes if "a search for the limits alone" in note]
    assert max(each.share_after for each in found.constraints) <= (10.0 - nearest) / 75.0 * (1.0 + 1e-6)
    assert len(told) == 2
    assert "at most 4; the nearest has" in told[0]
    assert f"{found.constraints[1].after:.6g}" in told[1]
    if method == "local":
        assert found.evaluations < 40


@pytest.mark.parametrize("radius_x", [40.0, 25.0])
def test_edges_are_those_between_the_rims(radius_x: float) -> None:
    """Where a lens is thinnest at its rim, which is in the section of its shorter radius."""
    scene = plano_convex(40.0, 3.0).changed({"camera.lens.surfaces[0].biconic": {"radius_x_mm": radius_x}})
    found = lf.optimise(
        scene, [{"path": THICKNESS, "range": [1.0, 10.0]}], [{"metric": "edge_thickness_mm", "target": 1.5}]
    )
    sag = radius_x - math.sqrt(radius_x**2 - 5.0**2)
    assert found.scene.camera.lens.surfaces[0].thickness_mm == pytest.approx(1.5 + sag, rel=1e-9)


def test_an_achromat_gets_its_glasses_back() -> None:
    """The flint that goes with the published radii is picked, and the crown too, of nine pairs."""
    scene = camera("achromat_100mm", 97.1, (486.1, 587.6, 656.3))
    path = "camera.lens.surfaces[{}].glass".format
    crowns, flints = ["SCHOTT/N-BK7", "SCHOTT/N-SK16", "SCHOTT/N-K5"], ["SCHOTT/SF5", "SCHOTT/F2", "SCHOTT/N-BAK4"]
    scene = scene.changed({"camera.lens": lf.solved(scene).camera.lens.model_dump()})
    wrong = scene.changed({path(0): crowns[2], path(1): flints[2]})
    found = lf.optimise(
        wrong,
        [
            {"path": path(0), "values": crowns},
            {"path": path(1), "values": flints},
            {"path": "camera.sensor.distance_mm", "range": [80.0, 120.0]},
        ],
        [{"metric": "spot_rms_mm"}],
        rays={"object_mm": math.inf, "height_mm": 1.0, "across": 6},
    )
    picked = [variable.after for variable in found.variables[:2]]
    assert picked == [crowns[0], flints[0]]


def test_a_detuned_triplet_comes_back_to_its_published_spots_or_better() -> None:
    published = camera("cooke_triplet_50mm", PUBLISHED_SENSOR_MM)
    signs = iter(np.random.default_rng(7).choice([-1.0, 1.0], 20))
    start = detuned(published, signs)
    rays = {"object_mm": math.inf, "height_mm": TRIPLET_MM}
    found = lf.optimise(
        start,
        lens_variables(start, (1, 3)),
        [{"metric": "spot_rms_mm", "weight": 1000.0}, {"metric": "efl_mm", "target": 50.0, "weight": 20.0}],
        rays={**rays, "across": 5},
    )

    def spots(scene: lf.Scene) -> np.ndarray:
        """The lens sheet's, which knows nothing of the merit."""
        return np.array([spot.rms_mm for spot in lf.analyse(scene, across=20, **rays).spots])

    def over_fields(scene: lf.Scene) -> float:
        return float(np.sqrt(np.mean(spots(scene) ** 2)))

    assert over_fields(start) > 5.0 * over_fields(published)
    assert over_fields(found.scene) < over_fields(published)
    assert lf.first_order(found.scene).efl_mm == pytest.approx(50.0, rel=2e-3)


def test_a_camera_is_laid_out_for_a_depth_range_and_a_resolution() -> None:
    """The plane in focus is the harmonic mean of the ends of the range."""
    found = best_of(load_design(DESIGNS / "plenoptic.toml"))
    facts = lf.first_order(found.scene)
    assert (facts.near_mm, facts.far_mm) == pytest.approx((350.0, 600.0), rel=1e-6)
    assert facts.object_distance_mm == pytest.approx(2.0 / (1.0 / 350.0 + 1.0 / 600.0), rel=1e-6)
    assert facts.object_sampling_mm == pytest.approx(0.5, rel=1e-6)
    assert facts.views_across == pytest.approx(14.0, rel=1e-6)
    assert facts.micro_image_diameter_px == pytest.approx(facts.micro_image_pitch_px, rel=1e-5)
    assert not found.missed


def test_differential_evolution_leaves_a_valley_that_least_squares_stays_in() -> None:
    """The MTF of a spot out of focus has side lobes: a local search finds no way out of one."""
    scene = plano_convex().changed({"camera.sensor.distance_mm": 80.0})
    variables = [{"path": "camera.sensor.distance_mm", "range": [50.0, 95.0]}]
    merit = [{"metric": "mtf", "per_mm": 4.0, "field": 0.0}]
    local, best = (
        lf.optimise(scene, variables, merit, rays={"object_mm": 1000.0, "across": 16}, search=search)
        for search in ({}, {"method": "global", "evaluations": 200})
    )
    assert best.merit_after < 0.1 * local.merit_after
    paraxial = lf.first_order(plano_convex()).image_z_mm - 3.0
    assert best.scene.camera.sensor.distance_mm == pytest.approx(paraxial, rel=0.01)


def test_a_frequency_that_the_rays_do_not_resolve_is_noted() -> None:
    """A grid of rays makes the moiré of a sharp image of a spot that is wide; other rays show that there is none."""
    scene = plano_convex().changed({"camera.sensor.distance_mm": 88.23})
    found = lf.optimise(
        scene,
        [{"path": "camera.sensor.distance_mm", "range": [87.0, 89.0]}],
        [{"metric": "mtf", "per_mm": 12.0, "field": 0.0}],
        rays={"object_mm": 1000.0, "across": 16},
    )
    assert found.terms[0].after > 0.9
    assert any("raise across" in note for note in found.notes)


def test_starts_are_drawn_from_the_seed() -> None:
    scene = camera("achromat_100mm", 97.1, (486.1, 587.6, 656.3))
    found = [
        lf.optimise(
            scene,
            lens_variables(scene),
            [{"metric": "spot_rms_mm"}],
            rays={"object_mm": math.inf, "height_mm": 1.0, "across": 4},
            search={"starts": 3, "seed": 5, "evaluations": 5},
        )
        for _ in range(2)
    ]
    assert found[0].starts == found[1].starts == 3
    assert found[0].scene == found[1].scene


@pytest.mark.parametrize("design", ["plenoptic", "triplet"])
def test_the_designs_that_come_with_lfmesh_have_a_camera_to_begin_with(design: str) -> None:
    problem = load_design(DESIGNS / f"{design}.toml")
    assert problem.rated(problem.start).finite


@pytest.mark.parametrize(("evaluations", "cut"), [(2, True), (200, False)])
def test_a_search_that_is_cut_short_says_so(evaluations: int, cut: bool) -> None:
    found = lf.optimise(
        plano_convex(),
        [{"path": RADIUS, "range": [20.0, 90.0]}],
        focal_length(80.0),
        search={"evaluations": evaluations},
    )
    assert any(f"evaluations = {evaluations}" in note for note in found.notes) == cut


def test_an_interrupt_keeps_the_best_camera_so_far() -> None:
    scene = camera("cooke_triplet_50mm", 43.0)
    count = itertools.count()

    def interrupt(_: str) -> None:
        if next(count) == 5:
            raise KeyboardInterrupt

    found = lf.optimise(
        scene,
        lens_variables(scene),
        [{"metric": "spot_rms_mm"}],
        rays={"object_mm": math.inf, "height_mm": 5.0, "across": 4},
        progress=interrupt,
    )
    assert not found.complete
    assert 0.0 < found.merit_after < found.merit_before
    assert "stopped before" in str(found)


def test_a_figure_of_pictures_is_met_with_common_random_numbers() -> None:
    """Chief rays of an array that is shifted by a pixel land a pixel off; the shift is found from where they land."""
    scene = small_scene()
    pixel = scene.camera.sensor.pixel_mm
    found = lf.optimise(scene, [{"path": SHIFT, "range": [-0.2, 0.2]}], [{"metric": "chief_rays_x_px", "target": 0.5}])
    shift = found.scene.camera.mla.pose.shift_mm[0] if found.scene.camera.mla is not None else 0.0
    facts = lf.first_order(scene)
    assert facts.micro_image_pitch_px is not None
    magnified = facts.micro_image_pitch_px * pixel / 0.5
    assert shift == pytest.approx(0.5 * pixel / magnified, rel=0.02)
    assert "common random numbers" in " ".join(str(found).split())


class Hidden(Renders):
    """Pictures of which the figure, the square of a shift of the array, is not known at some shifts."""

    def __init__(self, is_known: Callable[[float], bool]) -> None:
        super().__init__(small_scene(), ["chief_rays_x_px"])
        self.is_known = is_known

    def values(self, scene: lf.Scene) -> np.ndarray:
        assert scene.camera.mla is not None
        shift = scene.camera.mla.pose.shift_mm[0]
        return np.array([1.0 + shift**2 if self.is_known(shift) else math.nan])


def found_with(is_known: Callable[[float], bool], monkeypatch: pytest.MonkeyPatch) -> lf.Optimum:
    monkeypatch.setattr(Problem, "renders", Hidden(is_known))
    scene = small_scene().changed({SHIFT: 0.1})
    return lf.optimise(scene, [{"path": SHIFT, "range": [-0.2, 0.2]}], [{"metric": "chief_rays_x_px", "target": 1.0}])


def test_a_search_goes_on_past_neighbours_that_are_not_known(monkeypatch: pytest.MonkeyPatch) -> None:
    """On one side of each difference the figure is hidden: the other side tells its derivative as well."""
    found = found_with(lambda shift: shift < 0.1001, monkeypatch)
    assert found.scene.camera.mla is not None
    assert found.scene.camera.mla.pose.shift_mm[0] == pytest.approx(0.0, abs=1e-3)
    assert not any("not known" in note for note in found.notes)


def test_a_search_that_ends_where_no_derivative_is_known_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    found = found_with(lambda shift: shift == 0.1 or abs(shift) > 0.15, monkeypatch)
    (note,) = (note for note in found.notes if "is unknown" in note)
    assert note.startswith("a search ended at a camera around which chief_rays_x_px is unknown")


def test_a_figure_of_pictures_that_is_not_known_at_first_is_refused_with_its_reason() -> None:
    scene = small_scene(samples=8).changed({"camera.sensor.pose.shift_mm[0]": 40.0})
    with pytest.raises(
        lf.LfmeshError, match=r"centres_rms_px is not known in the starting camera: the white image shows no"
    ):
        lf.optimise(scene, [{"path": SHIFT, "range": [-0.2, 0.2]}], [{"metric": "centres_rms_px"}])


def test_the_scene_of_a_result_is_that_of_a_file(tmp_path: Path) -> None:
    found = lf.optimise(plano_convex(), [{"path": RADIUS, "range": [20.0, 90.0]}], focal_length(80.0))
    lf.save(found.scene, tmp_path / "best.toml")
    assert lf.load(tmp_path / "best.toml") == found.scene


REFLECTANCE, GLASS = "camera.sensor.reflectance", "camera.lens.surfaces[0].glass"


@pytest.mark.parametrize("search", [{"starts": 3}, {"method": "global", "evaluations": 50}])
def test_a_variable_that_no_term_depends_on_is_left_as_it_is(search: dict[str, Any]) -> None:
    scene = plano_convex().changed({REFLECTANCE: 0.3})
    found = lf.optimise(
        scene,
        [
            {"path": REFLECTANCE, "range": [0.0, 0.9]},
            {"path": RADIUS, "range": [20.0, 90.0]},
            {"path": "camera.lens.surfaces[1].semi_diameter_mm", "values": [5.0, 5.5, 6.0]},
        ],
        focal_length(80.0),
        search=search,
    )
    idle = [note for note in found.notes if note.startswith("no term depends on ")]
    assert [note.split()[4].rstrip(":") for note in idle] == [REFLECTANCE, "camera.lens.surfaces[1].semi_diameter_mm"]
    assert [variable.note for variable in found.variables] == ["left as it was", "", "left as it was"]
    assert found.scene.camera.sensor.reflectance == 0.3
    assert found.scene.camera.lens.surfaces[1].semi_diameter_mm == 5.0
    assert found.merit_after < 1e-9


def test_a_variable_that_matters_only_once_another_one_has_moved_is_varied() -> None:
    """The conic constant of a flat face."""
    flat = "camera.lens.surfaces[1]"
    scene = plano_convex().changed({f"{flat}.conic": 0.0, "camera.sensor.distance_mm": 60.0})
    found = lf.optimise(
        scene,
        [{"path": f"{flat}.conic", "range": [-3.0, 1.0]}, {"path": f"{flat}.radius_mm", "range": [-30.0, 30.0]}],
        [{"metric": "spot_rms_mm", "field": 0.0}],
        rays={"object_mm": math.inf, "height_mm": 1.0, "across": 4},
        search={"evaluations": 3},
    )
    assert not any("no term depends" in note for note in found.notes)


@pytest.mark.parametrize(("height_mm", "few"), [(1.0, False), (500.0, True)])
def test_a_height_at_which_most_rays_are_stopped_is_noted(height_mm: float, few: bool) -> None:
    scene = camera("achromat_100mm", 97.1, (486.1, 587.6, 656.3))
    rays = {"object_mm": math.inf, "height_mm": height_mm}
    found = lf.optimise(
        scene,
        [{"path": "camera.sensor.distance_mm", "range": [95.0, 99.0]}],
        [{"metric": "spot_rms_mm"}],
        rays={**rays, "across": 8},
        search={"evaluations": 2},
    )
    notes = [note for note in found.notes if note.startswith("height_mm")]
    assert len(notes) == few
    if few:
        assert f"height_mm = {height_mm:g}" in notes[0]
        assert f"% at {height_mm:g} mm" in notes[0]
    told = str(found)[str(found).index("note: ") :]
    assert max(map(len, told.splitlines())) <= COLUMNS


def test_a_value_with_which_rays_lose_their_path_is_said_not_to_be_searched() -> None:
    """Total reflection at the flat face: rays at the edge come to it at 40 degrees, and sin 40° > 1/3."""
    path = "camera.lens.surfaces[0].index"
    found = lf.optimise(
        plano_convex(6.0, 5.0),
        [{"path": path, "values": [1.6, 1.7, 3.0]}],
        [{"metric": "spot_rms_mm", "field": 0.0}],
        rays={"object_mm": math.inf, "height_mm": 0.1, "across": 10},
    )
    lost = [note for note in found.notes if "was not searched" in note]
    assert len(lost) == 1
    assert lost[0].startswith(f"{path} = 3.0 was not searched")

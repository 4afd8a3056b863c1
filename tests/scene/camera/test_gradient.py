"""Gradient-index glass in a scene: its keys, its formulas, its faults and its lines in `check`."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.errors import GlassError
from lfmesh.optics.glass import D_LINE_NM, medium_in_words, refractive_index
from lfmesh.optics.gradients import fields_at, gradient_table
from lfmesh.scene.camera.gradient import Gradient
from lfmesh.scene.first_order.gradient_lines import gradient_lines
from lfmesh.scene.first_order.solve import solved

ROD = {"kind": "radial_n2", "index": 1.6, "coefficients": [-0.09]}
SENSOR = {"pixels": [8, 8], "pixel_mm": 0.01}
ARRAY = {"count": [4, 4], "pitch_mm": 1.0, "thickness_mm": 3.0, "gradient": ROD}
POINT = (0.3, -0.5, 1.2)


def gradient_of(keys: Mapping[str, Any]) -> Gradient:
    gradient = lf.Surface(semi_diameter_mm=1.0, gradient=keys).gradient
    assert gradient is not None
    return gradient


def index_at(gradient: Gradient, wavelength_nm: float, point: tuple[float, float, float] = POINT) -> float:
    return math.sqrt(fields_at(gradient_table([gradient.profile(wavelength_nm)]), 0, [point])[0, 0])


def faces(front: Mapping[str, Any] | None = None, back: Mapping[str, Any] | None = None) -> list[dict[str, Any]]:
    return [
        {"thickness_mm": 3.0, "gradient": ROD, "semi_diameter_mm": 1.0, "stop": True} | dict(front or {}),
        {"semi_diameter_mm": 1.0} | dict(back or {}),
    ]


def scene_of(surfaces: list[dict[str, Any]] | None = None, **keys: Any) -> lf.Scene:
    beside = {key: keys.pop(key) for key in ("transport", "coatings") if key in keys}
    camera = {"lens": {"surfaces": surfaces or faces()}, "focus_mm": 500.0, "sensor": SENSOR} | keys
    return lf.Scene(camera=camera, **beside)


@pytest.mark.parametrize(
    ("keys", "wanted"),
    [
        (ROD | {"coefficients": [-0.09, 0.002]}, 1.6 * math.sqrt(1.0 - 0.09 * 0.34 + 0.002 * 0.34**2)),
        (
            {"kind": "radial_n", "index": 1.6, "coefficients": [-0.07, 0.01], "axial_coefficients": [0.02, -0.003]},
            1.6 - 0.07 * 0.34 + 0.01 * 0.34**2 + 0.02 * 1.2 - 0.003 * 1.44,
        ),
        ({"kind": "axial", "index": 1.6, "coefficients": [0.02, -0.003]}, 1.6 + 0.02 * 1.2 - 0.003 * 1.44),
        (
            {"kind": "spherical", "index": 1.6, "coefficients": [0.02, -0.003], "radius_mm": -8.0},
            1.6 + 0.02 * (math.sqrt(0.34 + 9.2**2) - 8.0) - 0.003 * (math.sqrt(0.34 + 9.2**2) - 8.0) ** 2,
        ),
        (
            {
                "kind": "xyz", "index": 1.6, "x_coefficients": [0.01, -0.02], "y_coefficients": [0.03],
                "z_coefficients": [0.0, 0.004],
            },
            1.6 + 0.01 * 0.3 - 0.02 * 0.09 - 0.03 * 0.5 + 0.004 * 1.44,
        ),
        (
            {"kind": "selfoc", "index": [1.58, 0.008], "gradient_constant_per_mm": [0.29, 0.005, 0.0003]},
            (1.58 + 0.032) * (1.0 - (0.29 + 0.02 + 0.0048) ** 2 * 0.17),
        ),
        (
            {"kind": "gradium", "coefficients": [1.7, -0.05, 0.01], "blank_mm": 8.0, "offset_mm": 0.8},
            1.7 - 0.05 * 0.25 + 0.01 * 0.0625,
        ),
    ],
)  # fmt: skip
def test_each_kind_has_its_formula(keys: dict[str, Any], wanted: float) -> None:
    gradient = gradient_of(keys)
    assert index_at(gradient, 500.0) == pytest.approx(wanted, rel=1e-14)
    assert gradient.index_at(500.0) == pytest.approx(index_at(gradient, 500.0, (0.0, 0.0, 0.0)), rel=1e-15)


def test_dispersion_holds_at_its_reference_wavelength_and_moves_the_index_elsewhere() -> None:
    """n² = n_ref² + (λ² − λ_ref²) (K₁ + K₂ n_ref) / (λ² − L)."""
    dispersion = {"reference_nm": 600.0, "strengths": [[0.01, 0.02]], "resonances_um2": [[0.015]]}
    plain = {"kind": "radial_n", "index": 1.6, "coefficients": [-0.07]}
    gradient = gradient_of(plain | {"dispersion": dispersion})
    reference = index_at(gradient_of(plain), 600.0)
    assert index_at(gradient, 600.0) == pytest.approx(reference, rel=1e-15)
    strength = 0.01 + 0.02 * reference
    wanted = math.sqrt(reference**2 + (0.25 - 0.36) * strength / (0.25 - 0.015))
    assert index_at(gradient, 500.0) == pytest.approx(wanted, rel=1e-14)


def test_a_gradient_is_a_medium() -> None:
    surface = lf.Surface(semi_diameter_mm=1.0, gradient=ROD)
    assert surface.medium == surface.gradient
    assert refractive_index(surface.medium, D_LINE_NM) == pytest.approx(1.6, rel=1e-15)
    assert medium_in_words(surface.medium) == "gradient radial_n2, n = 1.6 at the vertex"
    assert lf.MicrolensArray(**ARRAY).medium == surface.gradient
    assert hash(surface.gradient) == hash(gradient_of(ROD))


def test_a_scene_with_gradients_reads_its_own_file() -> None:
    scene = scene_of(mla=ARRAY)
    again = lf.loads(scene.dump_toml())
    assert again.camera == scene.camera
    assert solved(again).camera == solved(scene).camera


def test_coefficients_tell_revolution_and_symmetry() -> None:
    xyz = {"kind": "xyz", "index": 1.6}
    round_one = gradient_of(xyz | {"x_coefficients": [0.0, -0.02], "y_coefficients": [0.0, -0.02, 0.0]})
    assert round_one.of_revolution
    assert not round_one.turns_axis
    even = lf.Surface(semi_diameter_mm=1.0, gradient=xyz | {"x_coefficients": [0.0, -0.02]})
    assert even.asymmetric_key == "gradient"
    assert even.is_symmetric
    odd = lf.Surface(semi_diameter_mm=1.0, gradient=xyz | {"y_coefficients": [0.01]})
    assert not odd.is_symmetric
    assert odd.gradient is not None
    assert odd.gradient.turns_axis
    assert lf.Surface(semi_diameter_mm=1.0, gradient=ROD).asymmetric_key is None


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"kind": "radial"}, "valid kinds are radial_n2, radial_n, axial, spherical, xyz, selfoc, gradium"),
        ({"kind": "radial_n2", "index": 1.6}, r"gradient.coefficients: missing"),
        (ROD | {"coefficients": []}, r"coefficients = \[\]: must not be empty"),
        (ROD | {"index": 0.0}, r"gradient.index = 0.0: must be above 0"),
        (ROD | {"dispersion": {}}, r"gradient.dispersion: unknown key"),
        ({"kind": "xyz", "index": 1.6}, r"gradient.x_coefficients: missing: give the coefficients of x, y or z"),
        (
            {
                "kind": "axial", "index": 1.6, "coefficients": [0.1],
                "dispersion": {"reference_nm": 500.0, "strengths": [[0.1], [0.2]], "resonances_um2": [[0.01]]},
            },
            r"dispersion.resonances_um2: has 1 terms, but strengths has 2",
        ),
    ],
)  # fmt: skip
def test_kinds_refuse_their_faults(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(lf.SceneError, match=said):
        gradient_of(keys)


@pytest.mark.parametrize(
    ("surface", "said"),
    [
        ({"index": 1.5}, r"gradient: index = 1.5 is given too"),
        ({"glass": "SCHOTT/N-BK7"}, r"gradient: glass is given too"),
        ({"paraxial": True, "focal_length_mm": 30.0}, r"gradient: omit it: a paraxial surface is a flat thin lens"),
        (
            {"refractor": {"file": "a.stl", "units": "mm", "index": 1.5}},
            r"gradient: omit it: the refractor is a whole element",
        ),
        ({"mesh": {"file": "a.stl", "units": "mm", "side": "back"}}, r"gradient: omit it: .* not a mesh"),
    ],
)
def test_surfaces_that_take_no_gradient_say_so(surface: dict[str, Any], said: str) -> None:
    with pytest.raises(lf.SceneError, match=said):
        lf.Surface(semi_diameter_mm=1.0, gradient=ROD, **surface)


RADIAL_PHASE = {"kind": "radial", "coefficients_rad": [-1.0], "radius_mm": 1.0}


@pytest.mark.parametrize(
    ("surfaces", "said"),
    [
        ([*faces()[:1]], r"surfaces\[0\].gradient: omit it: the last surface looks into a homogeneous medium"),
        (faces(back={"gradient": ROD}), r"surfaces\[1\].gradient: omit it: the last surface"),
        (
            faces(back={"paraxial": True, "focal_length_mm": 20.0}),
            r"surfaces\[1\].paraxial = true: surfaces\[0\] puts glass before it",
        ),
        (
            faces(back={"mesh": {"file": "a.stl", "units": "mm", "side": "back"}}),
            r"surfaces\[0\].gradient: omit it: surfaces\[1\] is a mesh",
        ),
        (
            [
                faces()[0],
                {"refractor": {"file": "a.stl", "units": "mm", "index": 1.5}},
            ],
            r"surfaces\[0\].gradient: omit it: surfaces\[1\] is a refractor",
        ),
        (
            [faces({"stop": False})[0], faces()[0], faces()[1]],
            r"surfaces\[1\].stop = true: omit it: the stop would lie within gradient glass, from surfaces\[0\] on",
        ),
        (faces({"finish": "diffuse"}), r"surfaces\[0\].finish = \"diffuse\": must be polished"),
        (faces(back={"finish": "diffuse"}), r"surfaces\[1\].finish = \"diffuse\": must be polished"),
        (faces({"phase": RADIAL_PHASE}), r"surfaces\[0\].phase: omit it: a phase is not traced on a face of gradient"),
        (faces(back={"phase": RADIAL_PHASE}), r"surfaces\[1\].phase: omit it: a phase is not traced"),
    ],
)
def test_gaps_that_cannot_be_traced_are_refused(surfaces: list[dict[str, Any]], said: str) -> None:
    with pytest.raises(lf.SceneError, match=said):
        lf.Lens(surfaces=surfaces)


def test_gradient_glass_belongs_to_one_element() -> None:
    with pytest.raises(lf.SceneError, match=r"surfaces\[0\].gradient: surfaces 0 and 1 must belong to one element"):
        lf.Lens(surfaces=faces(), elements=[{"surfaces": [1], "pose": {"shift_mm": [0.0, 0.1, 0.0]}}])
    lf.Lens(surfaces=faces(), elements=[{"surfaces": [0, 1], "pose": {"shift_mm": [0.0, 0.1, 0.0]}}])


def test_a_stop_on_a_face_of_gradient_glass_is_a_face() -> None:
    lens = lf.Lens(surfaces=faces({"stop": False}, {"stop": True}))
    assert not lens.is_pure_stop(1)
    assert lens.last_interface == 1
    front = lf.Lens(surfaces=faces())
    assert not front.is_pure_stop(0)
    assert front.media[1] == front.surfaces[0].gradient


@pytest.mark.parametrize(
    ("transport", "said"),
    [
        ({"polarisation": True}, r"surfaces\[0\].gradient: omit it: transport.polarisation"),
        ({"surface": "patch"}, r"surfaces\[0\].gradient: needs transport.surface = \"exact\""),
        ({"engine": "mesh"}, r"surfaces\[0\].gradient: needs transport.engine = \"auto\" or \"sequential\""),
        (
            {"diffraction": "stop", "split": "transmit"},
            r"transport.diffraction = \"stop\": needs a homogeneous medium on both sides of the stop",
        ),
    ],
)
def test_settings_that_exclude_a_gradient_say_so(transport: dict[str, Any], said: str) -> None:
    with pytest.raises(lf.SceneError, match=said):
        scene_of(transport=transport)


def test_the_kick_of_lenslets_needs_a_homogeneous_plate() -> None:
    with pytest.raises(lf.SceneError, match=r"diffraction = \"lenslets\": is not traced behind lenslets of gradient"):
        scene_of(mla=ARRAY, transport={"diffraction": "lenslets"})


def test_coatings_that_depend_on_the_index_are_refused() -> None:
    layers = {"ar": {"layers": [{"index": 1.38, "thickness_nm": 106.5}]}}
    for surfaces, number in ((faces({"coating": "ar"}), 0), (faces(back={"coating": "ar"}), 1)):
        with pytest.raises(lf.SceneError, match=rf"surfaces\[{number}\].coating = \"ar\": its layers depend on"):
            scene_of(surfaces, coatings=layers)
    with pytest.raises(lf.SceneError, match=r"mla.flat_coating = \"ar\": its layers depend on the index"):
        scene_of(mla=ARRAY | {"flat_coating": "ar"}, coatings=layers)
    scene_of(faces({"coating": "ar"}), coatings={"ar": {"reflectance": 0.01}})


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"index": 1.5}, r"gradient: index = 1.5 is given too"),
        ({"glass": "SCHOTT/N-BK7"}, r"gradient: glass is given too"),
        ({"focal_length_mm": 2.0}, r"focal_length_mm = \[2.0\]: with a gradient the whole plate"),
        ({"curved_finish": "diffuse"}, r"curved_finish = \"diffuse\": must be polished"),
        ({"flat_finish": "diffuse"}, r"flat_finish = \"diffuse\": must be polished"),
        ({"flat_phase": RADIAL_PHASE}, r"flat_phase: omit it: a phase is not traced"),
        ({"walls": "glass"}, r"walls = \"glass\": must be 'absorb' or 'clear'"),
        ({"gradient": None, "index": 1.5, "radius_mm": 2.0, "walls": "clear"}, r"walls = \"clear\": omit it"),
        ({"gradient": None}, r"missing: give the plate's index, glass or gradient"),
    ],
)
def test_arrays_refuse_what_excludes_a_gradient(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(lf.SceneError, match=said):
        lf.MicrolensArray(**(ARRAY | keys))


def test_a_plate_with_a_gradient_may_be_flat() -> None:
    mla = lf.MicrolensArray(**ARRAY, walls="clear")
    assert mla.radii_mm == (math.inf,)
    assert mla.types == 1
    ready = solved(scene_of(mla=ARRAY)).camera.mla
    assert ready is not None
    assert ready.radius_mm == (math.inf,)


def test_an_index_below_1_on_the_axis_is_refused_where_it_occurs() -> None:
    with pytest.raises(lf.SceneError, match=r"surfaces\[0\].gradient: .* index 0.7 on the axis at z = 3 mm"):
        scene_of(faces({"gradient": {"kind": "axial", "index": 1.6, "coefficients": [-0.3]}}))
    # The square of the formula is above 1 at both faces.
    with pytest.raises(lf.SceneError, match=r"mla.gradient: .* index -1.1 on the axis"):
        scene_of(mla=ARRAY | {"gradient": {"kind": "axial", "index": 1.6, "coefficients": [-0.9]}})
    gradient = gradient_of({"kind": "selfoc", "index": [0.5, 0.0], "gradient_constant_per_mm": [0.1, 0.0, 0.0]})
    with pytest.raises(GlassError, match="must lie between 1 and 10"):
        gradient.index_at(500.0)


@pytest.mark.parametrize(
    ("gradient", "said"),
    [
        ({"kind": "radial_n", "index": 1.6, "coefficients": [-0.8]}, r"index -1.6 at 2 mm from the axis, z = 0 mm"),
        (
            {"kind": "selfoc", "index": [1.6, 0.0], "gradient_constant_per_mm": [1.0, 0.0, 0.0]},
            r"index -1.6 at 2 mm from the axis",
        ),
        ({"kind": "radial_n2", "index": 1.6, "coefficients": [-0.2]}, r"index 0.715542 at 2 mm from the axis"),
        ({"kind": "radial_n2", "index": 1.6, "coefficients": [-0.4]}, r"n² = -1.536 at 2 mm from the axis"),
        ({"kind": "radial_n", "index": 1.5, "coefficients": [-1.0, 0.25]}, r"index 0.5 at 1.414 mm from the axis"),
        ({"kind": "radial_n", "index": 1.6, "coefficients": [0.0, 0.0, 1.0]}, r"index 65.6 at 2 mm from the axis"),
        ({"kind": "xyz", "index": 1.6, "x_coefficients": [0.4]}, r"index 0.8 at 2 mm from the axis"),
        ({"kind": "radial_n2", "index": 1.6, "coefficients": [1e30]}, r"index 3.2e\+15 at 2 mm from the axis"),
        ({"kind": "radial_n2", "index": 1.6, "coefficients": [1e300]}, r"a term of the formula .* reaches 1.02e\+301"),
        ({"kind": "selfoc", "index": [1.6, 0.0], "gradient_constant_per_mm": [1e300, 0.0, 0.0]}, r"a term .* inf"),
    ],
)
def test_an_index_out_of_range_beside_the_axis_is_refused_where_it_occurs(gradient: dict[str, Any], said: str) -> None:
    wide = {"semi_diameter_mm": 2.0}
    with pytest.raises(lf.SceneError, match=rf"surfaces\[0\].gradient: .*{said}.*between 1 and 10 in all of the glass"):
        scene_of(faces({"gradient": gradient} | wide, wide))


def test_an_index_below_1_in_the_corner_of_a_cell_is_refused() -> None:
    """n = 1.6 − 1.2 r² is 1 at r = 0.7071, the corner of a square cell, and lower in one that is decentred."""
    rod = {"kind": "radial_n", "index": 1.6, "coefficients": [-1.2]}
    with pytest.raises(lf.SceneError, match=r"mla.gradient: .*index 0.98 at 0.7071 mm from the axis"):
        scene_of(mla=ARRAY | {"gradient": rod | {"coefficients": [-1.24]}})
    scene = scene_of(mla=ARRAY | {"gradient": rod, "form": {"decenter_mm": 0.01}})
    with pytest.raises(lf.SceneError, match=r"mla.gradient: .*index 0.9\d+ at 0.7\d+ mm from the axis"):
        lf.build(scene)


def test_the_depth_of_curved_faces_counts() -> None:
    """n = 1.03 − 0.05 z is 1 at 0.6 mm, and a back of radius −2 mm ends there at the rim, but not on the axis."""
    axial = {"kind": "axial", "index": 1.03, "coefficients": [-0.05]}
    front = {"gradient": axial, "thickness_mm": 0.7}
    back = {"radius_mm": -2.0, "semi_diameter_mm": 1.0}
    with pytest.raises(lf.SceneError, match=r"index 0.995 on the axis at z = 0.7 mm"):
        scene_of(faces(front, back))
    scene_of(faces(front | {"thickness_mm": 0.59}, back))
    with pytest.raises(lf.SceneError, match=r"index 0.987\d* at 1 mm from the axis, z = 0.8579 mm"):
        scene_of(faces(front | {"thickness_mm": 0.59}, back | {"radius_mm": 2.0}))


@pytest.mark.parametrize(
    ("gradient", "front", "said"),
    [
        ({"offset_mm": 2.0}, {}, None),
        ({"offset_mm": 2.1}, {}, "from 2.1 to 5.1 mm in a blank of 5 mm"),
        ({"offset_mm": 2.1}, {}, "give offset_mm from 0 to 2"),
        ({"blank_mm": 2.0, "offset_mm": 1.0}, {}, "give blank_mm = 3 or more"),
        # The rim of a concave face lies in front of its vertex.
        ({}, {"radius_mm": -10.0}, "from -0.0501256 to 3 mm in a blank of 5 mm"),
        ({}, {"radius_mm": -10.0}, "give offset_mm from 0.0501257 to 1.99999"),
    ],
)
def test_check_warns_of_a_lens_beyond_its_blank(
    gradient: dict[str, Any], front: dict[str, Any], said: str | None
) -> None:  # fmt: skip
    gradium = {"kind": "gradium", "coefficients": [1.7, -0.05], "blank_mm": 5.0} | gradient
    sensor = SENSOR | {"distance_mm": 20.0}
    scene = scene_of(faces({"gradient": gradium} | front), focus_mm=None, sensor=sensor)
    warned = [each for each in lf.first_order(scene).warnings if "blank" in each]
    assert len(warned) == (said is not None)
    assert all(each.startswith("camera.lens.surfaces[0].gradient: ") and str(said) in each for each in warned)


def test_a_kink_within_the_rounding_of_typed_coefficients_is_none() -> None:
    """n = 1.4 + c t − 0.004 t² is smooth at the centre of a ball of radius 5 for c = 0.04."""

    def ball(slope: float) -> lf.Scene:
        gradient = {"kind": "spherical", "index": 1.4, "radius_mm": 5.0, "coefficients": [slope, -0.004]}
        front = {"gradient": gradient, "radius_mm": 5.0, "thickness_mm": 10.0, "semi_diameter_mm": 4.0}
        return scene_of(faces(front, {"radius_mm": -5.0, "semi_diameter_mm": 4.0}))

    smooth = lf.first_order(ball(0.04)).efl_mm
    for kink in (4e-11, -4e-11, 5e-8):
        assert lf.first_order(ball(0.04 + kink)).efl_mm == pytest.approx(smooth, rel=1e-5)
    with pytest.raises(lf.SceneError, match=r"surfaces\[0\].gradient: .*kink .* z = 5 mm on the axis.* 1e-05 per mm"):
        ball(0.04001)


def test_plates_with_one_index_are_asked_for_by_name() -> None:
    camera = scene_of(mla=ARRAY).camera
    assert camera.mla is not None
    with pytest.raises(lf.SceneError, match=r"camera.mla.gradient: not supported here"):
        camera.relative_index(camera.mla.medium, 500.0)


def test_check_describes_each_gradient() -> None:
    lines = gradient_lines(solved(scene_of(mla=ARRAY)))
    rim = 1.6 * math.sqrt(1.0 - 0.09)
    focal = 1.0 / (1.6 * 0.3 * math.sin(0.9))
    assert lines[0].startswith("gradient behind surface 0")
    assert f"radial_n2: n = 1.6 at the vertex, {rim:.6g} to 1.6 up to 1 mm from the axis, 1.6 behind" in lines[0]
    assert lines[0].endswith(f"focal length between plane faces {focal:.6g} mm")
    assert lines[1].startswith("gradient of the array")
    assert gradient_lines(solved(scene_of(faces({"gradient": None, "index": 1.6}, {"radius_mm": -20.0})))) == []


def test_profiles_are_made_once_a_wavelength() -> None:
    gradient = gradient_of(ROD)
    assert gradient.profile(500.0) is gradient.profile(500)
    assert np.array_equal(gradient.profile(400.0).numbers, gradient.profile(500.0).numbers)

"""Files of optiland: surfaces, media and conditions as they stand, what is not read named or refused."""

import json
import math
from copy import deepcopy
from pathlib import Path

import pytest

from lfmesh.errors import SceneError
from lfmesh.imports import read_lens_file
from lfmesh.imports.optiland_json import read
from lfmesh.imports.report import Verdict
from lfmesh.scene.camera.lens import FileChoices

FILE = Path("lens.json")
AIR = {"type": "IdealMaterial", "index": 1.0, "absorp": 0.0}


def surface(kind, z, radius, medium=AIR, stop=False, **shape):
    frame = {"x": 0.0, "y": 0.0, "z": z, "rx": 0.0, "ry": 0.0, "rz": 0.0, "reference_cs": None}
    return {
        "type": "Surface",
        "geometry": {"type": kind, "cs": frame, "radius": radius, **shape},
        "material_post": medium,
        "is_stop": stop,
        "aperture": None,
        "comment": "",
        "interaction_model": {
            "type": "RefractiveReflectiveModel",
            "is_reflective": False,
            "coating": None,
            "bsdf": None,
        },
    }


GLASS = {"type": "Material", "filename": r"data-nk\glass\schott\N-BK7.yml", "name": "N-BK7", "reference": None}
LENS = {
    "version": 1.0,
    "name": "two lenses",
    "aperture": {"type": "EPD", "value": 8.0},
    "fields": {
        "fields": [{"x": 0.0, "y": 0, "vx": 0.0, "vy": 0.0}, {"x": 0.0, "y": 5, "vx": 0.0, "vy": 0.25}],
        "field_definition": {"field_type": "AngleField"},
    },
    "wavelengths": {
        "wavelengths": [
            {"value": 0.4861, "is_primary": False, "unit": "um"},
            {"value": 587.6, "is_primary": True, "unit": "nm"},
        ]
    },
    "pickups": [],
    "solves": {"solves": []},
    "surface_group": {
        "surfaces": [
            surface("Plane", -math.inf, math.inf),
            surface("EvenAsphere", 0.0, 25.0, GLASS, conic=-0.3, coefficients=[0.0, -2e-6, 1e-9], tol=1e-6),
            surface("StandardGeometry", 4.0, -60.0, conic=0.0),
            surface("Plane", 6.0, math.inf, stop=True),
            surface(
                "OddAsphere", 7.0, -40.0, {"type": "AbbeMaterial", "index": 1.62, "abbe": 36.4},
                conic=0.0, coefficients=[0, 0, 1e-6, 2e-7],
            ),
            surface("Plane", 9.0, math.inf),
            surface("Plane", 49.0, math.inf),
        ]
    },
}  # fmt: skip


def read_changed(change=lambda data: None, **options):
    data = deepcopy(LENS)
    change(data)
    return read(FILE, json.dumps(data).splitlines(), **options)


def test_surfaces_media_and_conditions_are_taken():
    lens, report = read_changed()
    first, second, stop, third, last = lens.surfaces
    assert (first.radius_mm, first.conic, first.glass, first.thickness_mm) == (25.0, -0.3, "SCHOTT/N-BK7", 4.0)
    assert (first.asphere_mm, second.radius_mm, second.medium) == ((-2e-6, 1e-9), -60.0, None)
    assert (stop.stop, stop.thickness_mm, third.glass.nd, third.glass.vd) == (True, 1.0, 1.62, 36.4)
    assert (third.odd_asphere_mm, third.asphere_mm, last.medium) == ((1e-6,), (2e-7,), None)
    held = report.conditions
    assert held is not None
    assert (held.wavelengths_nm, held.primary, held.image_mm, held.object_mm) == ((486.1, 587.6), 1, 40.0, math.inf)
    assert [(point.y, point.upper) for point in held.fields] == [(0.0, 1.0), (5.0, 0.75)]
    assert not report.of(Verdict.UNKNOWN)
    assert [line.text for line in report.of(Verdict.APPROXIMATED)] == ["surfaces[4]"]


def test_a_term_in_r_squared_bends_as_its_curvature():
    def change(data):
        data["surface_group"]["surfaces"][1]["geometry"] |= {"coefficients": [1e-4], "conic": 0.0}

    lens, _ = read_changed(change)
    assert lens.surfaces[0].radius_mm == pytest.approx(1.0 / (1.0 / 25.0 + 2e-4), rel=1e-15)


def of_surface(k, **changes):
    return lambda data: data["surface_group"]["surfaces"][k].update(changes)


def of_geometry(k, **changes):
    return lambda data: data["surface_group"]["surfaces"][k]["geometry"].update(changes)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (of_geometry(2, type="ZernikePolynomialGeometry"), "surfaces[2]: surfaces of type ZernikePolynomialGeometry"),
        (of_geometry(1, coefficients=[0.0] * 40 + [1e-90]), "a term in r^82"),
        (of_geometry(4, coefficients=[1e-3]), "a term in r makes a cone"),
        (of_geometry(2, radius="25"), 'radius = "25" must be a number'),
        (of_surface(2, material_post={"type": "Mirror"}), "mirrors are not supported"),
        (of_surface(2, material_post={"type": "GradientMaterial"}), "a medium of type GradientMaterial is not read"),
        (
            of_surface(
                2,
                material_post={
                    "type": "IdealMaterial",
                    "index": 1.5,
                    "propagation_model": {"class": "GRINPropagation"},
                },
            ),
            "a medium with the propagation GRINPropagation is not read; HomogeneousPropagation is",
        ),
        (of_surface(2, interaction_model={"type": "DiffractiveInteractionModel"}), "a curved grating is not read"),
        (of_surface(2, interaction_model={"type": "RefractiveReflectiveModel", "is_reflective": True}), "mirrors"),
        (of_surface(2, aperture={"type": "RadialAperture", "r_min": 1.0, "r_max": 5.0}), "without a dark middle"),
        (lambda data: data["surface_group"]["surfaces"][2]["geometry"]["cs"].update(rx=0.1), "off the axis (rx)"),
        (lambda data: data["surface_group"]["surfaces"][2]["geometry"]["cs"].update(z=[4.0]), "[4.0] must be a number"),
        (
            of_surface(2, material_post={"type": "IdealMaterial", "index": 0}),
            "index 0: a refractive index must be above",
        ),
        (lambda data: data["aperture"].update(type="imageNA"), "an aperture of type imageNA is not read"),
        (lambda data: data["fields"].update(field_definition={"field_type": "X"}), "fields of type X are not read"),
        (lambda data: data.pop("wavelengths"), "wavelengths: it has no wavelengths"),
        (lambda data: data.pop("surface_group"), "not an optiland lens file"),
    ],
)
def test_what_the_lens_cannot_have_is_refused_in_one_line(change, said):
    with pytest.raises(SceneError) as raised:
        read_changed(change)
    assert said in str(raised.value)
    assert "\n" not in str(raised.value)


def test_apertures_stop_light_and_a_stop_may_size_the_beam():
    def change(data):
        data["surface_group"]["surfaces"][1]["aperture"] = {"type": "RadialAperture", "r_min": 0, "r_max": 5.5}
        data["aperture"] = {"type": "float_by_stop_size", "value": 6.0}

    lens, _ = read_changed(change)
    assert (lens.surfaces[0].semi_diameter_mm, lens.surfaces[2].semi_diameter_mm) == (5.5, 3.0)


def test_what_is_not_known_is_named_and_coatings_are_said_to_be_bare():
    def change(data):
        data["apodization"] = {"type": "Gaussian", "sigma": 1.0}
        data["surface_group"]["surfaces"][2]["interaction_model"]["coating"] = {"type": "SimpleCoating"}

    _, report = read_changed(change)
    assert [line.text for line in report.of(Verdict.UNKNOWN)] == ["apodization"]
    assert "surfaces[2].coating: approximated: not read; the surface is traced bare" in map(str, report.lines)


@pytest.mark.parametrize("content", ["", "[", "[1]", "{}", '{"surface_group": 3}', "[" * 100_000])
def test_files_that_are_none_are_refused_in_one_line(tmp_path, content):
    path = tmp_path / "a.json"
    path.write_text(content)
    with pytest.raises(SceneError, match=r"a\.json: not (JSON|an optiland lens file)"):
        read_lens_file(path)


def test_it_has_one_configuration():
    with pytest.raises(SceneError, match="configuration = 2: the file has one configuration"):
        read_changed(choices=FileChoices(configuration=2))


def places(entry, path=()):
    """Yield the paths of everything in a file of JSON."""
    for key, value in entry.items() if isinstance(entry, dict) else enumerate(entry):
        yield (*path, key)
        if isinstance(value, dict | list):
            yield from places(value, (*path, key))


@pytest.mark.parametrize("strange", [None, True, -1.0, "x", [], {}, [None], {"a": None}, "left out"])
@pytest.mark.filterwarnings("ignore::lfmesh.errors.LensFileWarning")
def test_a_value_of_another_kind_is_used_or_named(strange):
    # Beyond the second surface everything comes again.
    for path in [path for path in places(LENS) if len(path) < 3 or path[1] != "surfaces" or path[2] < 2]:
        data = deepcopy(LENS)
        *inner, last = path
        entry = data
        for key in inner:
            entry = entry[key]
        if strange == "left out":
            entry.pop(last)
        else:
            entry[last] = strange
        try:
            read(FILE, json.dumps(data).splitlines())
        except SceneError as error:
            message = str(error)
        else:
            continue
        told = [key for key in path if isinstance(key, str)] + [
            "holds no lens",
            "as a lens",
            "stands in a medium",
            "glass of nd",
        ]
        assert any(word in message for word in told), (path, message)


def test_a_surface_without_geometry_is_named():
    with pytest.raises(SceneError, match=r"lens\.json: surfaces\[1\]: geometry = null must be an object"):
        read_changed(lambda data: data["surface_group"]["surfaces"][1].update(geometry=None))


def test_a_medium_of_the_e_line_is_refused():
    with pytest.raises(SceneError, match="a medium of type AbbeMaterialE is not read"):
        read_changed(lambda data: data["surface_group"]["surfaces"][4]["material_post"].update(type="AbbeMaterialE"))

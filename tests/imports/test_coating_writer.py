"""Coatings written as a Zemax coating file and read again are the same."""

import numpy as np
import pytest

from lfmesh.imports import read_lens_file, write_lens_file
from lfmesh.imports.report import Verdict
from lfmesh.scene import Lens, Surface
from lfmesh.scene.materials.coatings import Coating, Layer, MeasuredIndex, MeasuredReflectance

THICKNESSES = np.random.default_rng(4).uniform(1.0, 400.0, 40).tolist()
"""Of all digits, so that a change of the unit would show rounding."""

FILM = MeasuredIndex(wavelengths_nm=(400.1, 555.55, 700.0), index=(2.1, 2.0, 1.9), extinction=(0.2, 0.0, 0.1))
COATINGS = {
    "stack": Coating(
        layers=tuple(Layer(index=1.38 + 0.01 * (i % 3), thickness_nm=t) for i, t in enumerate(THICKNESSES))
    ),
    "absorbing": Coating(
        layers=(Layer(index=0.2, extinction=3.4, thickness_nm=12.3), Layer(measured=FILM, thickness_nm=9))
    ),
    "AR": Coating(layers=(Layer(index=1.46, thickness_nm=100.0),)),
    "ar": Coating(reflectance=0.1 + 0.2),
    "null": Coating(reflectance=1.0),
    "measured": Coating(
        measured=MeasuredReflectance(
            wavelengths_nm=(450.0, 650.3),
            angles_deg=(0.0, 33.3, 90.0),
            reflectance=((0.01, 0.1 + 0.2, 1.0), (0.3, 0.4, 1.0)),
        )
    ),
}


def coated(coatings):
    """Return a lens whose surfaces have some coatings, in order."""
    names = [*coatings, *["none"] * (len(coatings) % 2)]
    surfaces = [
        {"radius_mm": 100.0, "thickness_mm": 2.0, "semi_diameter_mm": 4.0, "coating": name}
        | ({"index": 1.6} if i % 2 == 0 else {})
        for i, name in enumerate(names)
    ]
    surfaces[0]["stop"] = True
    surfaces[-1].pop("thickness_mm")
    return Lens(surfaces=tuple(Surface(**keys) for keys in surfaces), coatings=coatings)


def test_every_kind_of_coating_comes_back(tmp_path):
    lens = coated(COATINGS)
    path = tmp_path / 'a lens "of two words".zmx'
    (note,) = write_lens_file(lens, path)
    assert note.startswith("the coatings are in a lens _of two words__coating.dat; ")
    again, report = read_lens_file(path)
    assert not report.of(Verdict.APPROXIMATED)
    assert [again.coatings[surface.coating] for surface in again.surfaces] == list(COATINGS.values())
    assert [surface.coating for surface in again.surfaces] == ["stack", "absorbing", "AR", "ar-2", "null-2", "measured"]


def test_a_coating_without_an_entry_of_its_own_is_reported_and_not_written_as_bare(tmp_path):
    """Here one by a file: such a lens belongs to no scene file, but can be made."""
    lens = coated({"known": COATINGS["AR"], "other": COATINGS["ar"]})
    lens = lens.model_copy(update={"coatings": lens.coatings | {"other": Coating(table="other.csv")}})
    notes = write_lens_file(lens, tmp_path / "lens.zmx")
    assert "coatings of surfaces 1 are not in the file" in notes
    assert "other" not in (tmp_path / "lens_coating.dat").read_text()
    assert "COAT other" not in (tmp_path / "lens.zmx").read_text("utf-16")


def test_lenses_of_one_folder_keep_their_own_coatings(tmp_path):
    for name, share in (("one", 0.1), ("Two", 0.2), ("two", 0.3)):
        write_lens_file(coated({"c": Coating(reflectance=share)}), tmp_path / f"{name}.zmx")
    read = [read_lens_file(tmp_path / f"{name}.zmx")[0].coatings["c"].reflectance for name in ("one", "Two", "two")]
    assert read == [0.1, 0.2, 0.3]


def test_a_layer_of_the_catalogue_is_written_as_a_table_and_said(tmp_path):
    layer = Layer(glass="SCHOTT/N-SF11", thickness_nm=80.0)
    notes = write_lens_file(coated({"c": Coating(layers=(layer,))}), tmp_path / "lens.zmx")
    assert notes[1] == "a layer of SCHOTT/N-SF11 is written as a table from 370 to 1100 nm"
    (read,) = read_lens_file(tmp_path / "lens.zmx")[0].coatings["c"].layers
    for wavelength_nm in (402.5, 587.5618, 1013.98):
        assert read.index_at(wavelength_nm) == pytest.approx(layer.index_at(wavelength_nm), abs=1e-4)
    assert read.index_at(405.0) == layer.index_at(405.0)


@pytest.mark.parametrize("ending", [".zmx", ".seq"])
def test_coatings_that_a_file_does_not_hold_are_said(tmp_path, ending):
    lens = coated({"c": Coating(reflectance=0.5)})
    surfaces = (lens.surfaces[0], lens.surfaces[1].model_copy(update={"coating": "of_the_scene"}))
    notes = write_lens_file(lens.model_copy(update={"surfaces": surfaces}), tmp_path / f"lens{ending}")
    without = "1" if ending == ".zmx" else "0, 1"
    assert notes[0] == f"coatings of surfaces {without} are not in the file"

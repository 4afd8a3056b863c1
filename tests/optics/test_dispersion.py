"""Dispersion formulas against the makers' catalogues, and where they are refused."""

import numpy as np
import pytest

from lfmesh.errors import GlassError
from lfmesh.optics.dispersion import model_index, sellmeier_index, table_index
from lfmesh.optics.glass import C_LINE_NM, D_LINE_NM, F_LINE_NM, _catalogue, refractive_index

G_LINE_NM = 435.8343


def _normal_glasses() -> list[tuple[str, float, float]]:
    """Return SCHOTT's and OHARA's glasses near the normal line of TIE-29, with nd and Vd."""
    books = ("SCHOTT-optical", "OHARA-optical")
    pages = {page for pages in _catalogue().values() for page in pages if page[:1] == ("specs",) and page[1] in books}
    found = []
    for page in sorted(pages):
        name = "/".join(page)
        try:
            g, f, d, c = (refractive_index(name, line) for line in (G_LINE_NM, F_LINE_NM, D_LINE_NM, C_LINE_NM))
            refractive_index(name, 404.6561), refractive_index(name, 1013.98)
        except GlassError:
            continue
        vd = (d - 1.0) / (f - c)
        if abs((g - f) / (f - c) - (0.6438 - 0.001682 * vd)) < 0.002:
            found.append((name, d, vd))
    return found


@pytest.mark.parametrize(
    ("wavelength_nm", "allowed"),
    [(404.6561, 5e-4), (G_LINE_NM, 1e-4), (F_LINE_NM, 3e-5), (546.074, 3e-5), (D_LINE_NM, 1e-12), (C_LINE_NM, 3e-5),
     (706.5188, 1e-4), (1013.98, 5e-4)],
)  # fmt: skip
def test_the_model_follows_the_normal_glasses_of_catalogues(wavelength_nm: float, allowed: float) -> None:
    glasses = _normal_glasses()
    assert len(glasses) > 100
    errors = [abs(model_index(d, vd, wavelength_nm) - refractive_index(name, wavelength_nm)) for name, d, vd in glasses]
    assert max(errors) < allowed


def test_the_model_has_its_nd_and_vd() -> None:
    f, d, c = (model_index(1.62, 36.4, line) for line in (F_LINE_NM, D_LINE_NM, C_LINE_NM))
    assert d == pytest.approx(1.62, abs=1e-15)
    assert (d - 1.0) / (f - c) == pytest.approx(36.4, rel=1e-12)


def test_sellmeier_is_the_makers_formula() -> None:
    """Coefficients of N-BK7 as SCHOTT's data sheet prints them."""
    b, c = (1.03961212, 0.231792344, 1.01046945), (0.00600069867, 0.0200179144, 103.560653)
    for wavelength_nm in (365.0, 587.5618, 1529.6):
        assert sellmeier_index(b, c, wavelength_nm) == pytest.approx(
            refractive_index("SCHOTT/N-BK7", wavelength_nm), abs=1e-13
        )


@pytest.mark.parametrize(("glass", "allowed"), [("SCHOTT/N-BK7", 3e-6), ("SCHOTT/N-SF6", 6e-5)])
def test_a_table_is_smooth_between_its_values(glass: str, allowed: float) -> None:
    nodes = np.arange(400.0, 801.0, 50.0)
    values = [refractive_index(glass, w) for w in nodes]
    assert table_index(nodes, values, 550.0) == pytest.approx(values[3], abs=1e-15)
    between = np.linspace(400.0, 800.0, 173)
    assert max(abs(table_index(nodes, values, w) - refractive_index(glass, w)) for w in between) < allowed
    # The slope is continuous where two pieces meet; of lines between the values it would change by some 1e-5 per nm.
    left, right = ((table_index(nodes, values, 450.0 + a + 1e-3) - table_index(nodes, values, 450.0 + a)) / 1e-3
                   for a in (-1e-3, 0.0))  # fmt: skip
    assert abs(left - right) < 1e-8


def test_a_table_is_refused_outside_and_taken_at_its_ends() -> None:
    assert table_index((400.0, 700.0), (1.53, 1.51), 700.0) == pytest.approx(1.51, abs=1e-15)
    for outside in (399.9, 700.1):
        with pytest.raises(GlassError, match="its table reaches from 400 to 700 nm"):
            table_index((400.0, 700.0), (1.53, 1.51), outside)


def test_formulas_are_refused_where_they_give_no_index() -> None:
    with pytest.raises(GlassError, match="away from the resonances"):
        sellmeier_index((1.0,), (0.25,), 500.0)
    with pytest.raises(GlassError, match="nd and Vd determine the index only from 350 to 1100 nm"):
        model_index(1.5, 60.0, 1200.0)

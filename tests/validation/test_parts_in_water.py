"""What stands before a camera that looks into water, by closed forms: fog, hot gas, lamps, spheres, gloss, polarisers.

Brewster's angle of a face in water is the arc tangent of its index over that of water, and spheres and facets scatter
by the same ratio. Power and radiance are those in the water; out of it radiance is divided by n².
"""

from typing import Any

import numpy as np

import lfmesh as lf
from tests.validation.test_object_medium import PORT, WATER

WAVELENGTH = 587.6


def pinhole(**scene: Any) -> lf.Scene:
    """A pixel that sees rays within 3° of the axis through a port in water."""
    stop = {"stop": True, "semi_diameter_mm": 0.2}
    sensor = {"pixels": [1, 1], "pixel_mm": 0.1, "distance_mm": 10.0}
    camera = {"lens": {"surfaces": [*PORT[:2], stop]}, "sensor": sensor, "object_medium": {"index": WATER}}
    glow = {"shape": {"kind": "plane", "width_mm": 30.0, "height_mm": 30.0}, "position_mm": [0.0, 0.0, -100.0],
            "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}}  # fmt: skip
    return lf.Scene(
        camera=camera, targets=[glow], transport={"samples": 256, "split": "transmit", "threads": 1}, **scene
    )


def test_gas_in_water_emits_the_radiance_of_a_black_body_there() -> None:
    """That is n² times Planck's in air, by Kirchhoff; what a given emission is said to be in water it is."""
    bands = [{"name": "R", "center_nm": 620.0, "fwhm_nm": 20.0}]
    box = {"bounds": {"kind": "box", "size_mm": [9.0, 9.0, 4.0]}, "position_mm": [0.0, 0.0, -50.0]}
    media = [box | {"absorption_per_mm": 0.1, "temperature_k": 2500.0}, box | {"emission_w_mm3_sr": 1.0}]
    wet = pinhole().changed({"camera.sensor.bands": bands, "media": media})
    emission, in_air = (
        lf.build(scene).tables.objects.volumes.emission
        for scene in (wet, wet.changed({"camera.object_medium": {"index": 1.0}}))
    )
    np.testing.assert_allclose(emission[0], WATER**2 * in_air[0], rtol=1e-12)
    np.testing.assert_array_equal(emission[1], in_air[1])


def test_spheres_in_water_scatter_by_their_index_over_the_waters(tmp_path: Any) -> None:
    """The phase function of fog, and of particles in a sheet of light, is that of spheres said to be in water."""
    fog = {"bounds": {"kind": "box", "size_mm": [9.0, 9.0, 4.0]}, "position_mm": [0.0, 0.0, -50.0],
           "scattering_per_mm": 0.05}  # fmt: skip
    (tmp_path / "points.csv").write_text("x_mm,y_mm,z_mm\n0.0,0.0,-50.0\n")
    sheet = {"point_mm": [0.0, 0.0, -50.0], "normal": [0.0, 0.0, 1.0], "direction": [1.0, 0.0, 0.0],
             "thickness_mm": 2.0, "width_mm": 20.0, "power_w": 1.0}  # fmt: skip

    def tables(mie: dict[str, Any], medium: dict[str, Any]) -> Any:
        phase = {"kind": "mie", "diameter_um": 2.0, "index": 1.59} | mie
        particles = {"file": "points.csv", "sheet": sheet, "phase": phase}
        scene = pinhole(media=[fog | {"phase": phase}], particles=[particles]).in_folder(tmp_path)
        built = lf.build(scene.changed(medium))
        lit = built.particles[0]
        return [built.tables.objects.volumes.phases.values, np.append(lit.scale, lit.phases.values)]

    in_air = {"camera.object_medium": {"index": 1.0}}
    for own, said, dry in zip(
        tables({}, {}), tables({"surrounding_index": WATER}, in_air), tables({}, in_air), strict=True
    ):
        np.testing.assert_array_equal(own, said)
        assert own.shape != dry.shape or np.abs(own / dry - 1.0).max() > 0.1

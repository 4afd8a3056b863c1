"""The gradient-index glass of a camera in words."""

import numpy as np

from lfmesh.scene.camera.gradient import Gradient
from lfmesh.scene.first_order.paraxial import gradient_gap
from lfmesh.scene.scene import Scene


def gradient_lines(scene: Scene) -> list[str]:
    """Describe the gradient-index glass of a solved scene, one line each.

    A line gives the kind, the index at both vertices and beside the first one at the rim, and the focal length of the
    glass between plane faces in air, all at the primary wavelength.

    Parameters
    ----------
    scene : Scene
    """
    lines = []
    for where, gradient, length in scene.gradients():
        number, mla = where[-2], scene.camera.mla
        if isinstance(number, int):
            face, rim = f"gradient behind surface {number}", scene.camera.lens.surfaces[number].semi_diameter_mm or 0.0
        else:
            assert mla is not None
            face, rim = "gradient of the array", mla.corner_mm
        lines.append(f"{face:<34}{_in_words(gradient, scene.primary_nm, length, rim)}")
    return lines


def _in_words(gradient: Gradient, wavelength_nm: float, length_mm: float, rim_mm: float) -> str:
    from lfmesh.optics.gradients import fields_at, gradient_table

    gap = gradient_gap(gradient, wavelength_nm, length_mm)
    table = gradient_table([gradient.profile(wavelength_nm)])
    with np.errstate(invalid="ignore"):
        beside = float(np.sqrt(fields_at(table, 0, [[0.0, rim_mm, 0.0]])[0, 0]))
    power = -gap.matrix.c
    focal = f"focal length between plane faces {1.0 / power:.6g} mm" if power else "without power between plane faces"
    return (
        f"{getattr(gradient, 'kind', '')}: n = {gradient.index_at(wavelength_nm):.6g} at the vertex, {beside:.6g} at "
        f"{rim_mm:.4g} mm from the axis, {gap.end_index:.6g} behind {length_mm:.6g} mm; {focal}"
    )

"""The gradient-index glass of a camera in words."""

from collections.abc import Sequence

from lfmesh.optics.gradient_range import GlassRegion
from lfmesh.scene.camera.gradient import Gradient
from lfmesh.scene.first_order.paraxial import gradient_gap
from lfmesh.scene.scene import Scene


def gradient_lines(scene: Scene) -> list[str]:
    """Describe the gradient-index glass of a solved scene, one line each.

    A line gives the kind, the index at both vertices and its range in all of the glass, and the focal length of the
    glass between plane faces in air, all at the primary wavelength.

    Parameters
    ----------
    scene : Scene
    """
    lines = []
    for where, gradient, length in scene.gradients():
        number = where[-2]
        face = f"gradient behind surface {number}" if isinstance(number, int) else "gradient of the array"
        regions = [region for at, _, region in scene.gradient_regions() if at == where]
        lines.append(f"{face:<34}{_in_words(gradient, scene.primary_nm, length, regions)}")
    return lines


def _in_words(gradient: Gradient, wavelength_nm: float, length_mm: float, regions: Sequence[GlassRegion]) -> str:
    gap = gradient_gap(gradient, wavelength_nm, length_mm)
    ranges = [gradient.index_range(wavelength_nm, region) for region in regions]
    least, most = min(each.least.value for each in ranges), max(each.most.value for each in ranges)
    wide = max(region.radii_mm[1] for region in regions)
    power = -gap.matrix.c
    focal = f"focal length between plane faces {1.0 / power:.6g} mm" if power else "without power between plane faces"
    return (
        f"{getattr(gradient, 'kind', '')}: n = {gradient.index_at(wavelength_nm):.6g} at the vertex, {least:.6g} to "
        f"{most:.6g} up to {wide:.4g} mm from the axis, {gap.end_index:.6g} behind {length_mm:.6g} mm; {focal}"
    )

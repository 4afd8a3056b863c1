"""Image shift by the sensor's cover."""

from lfmesh.scene.camera.camera import Camera


def cover_shift_mm(camera: Camera, wavelength_nm: float) -> float:
    """Return the image shift away from the lens by the sensor's cover, t (1 - 1/n); 0 without a cover.

    The index n is relative to the image medium.
    """
    cover = camera.sensor.cover
    if cover is None:
        return 0.0
    return cover.thickness_mm * (1.0 - 1.0 / camera.relative_index(cover.medium, wavelength_nm))

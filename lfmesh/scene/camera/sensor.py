"""The sensor: pixels, cover glass, bands and position."""

from collections.abc import Iterator

from pydantic import Field

from lfmesh.scene.camera.bands import Bands, band_faults
from lfmesh.scene.camera.cover import Cover
from lfmesh.scene.model import Fault, Model
from lfmesh.scene.pose import Pose
from lfmesh.scene.quantities import FractionOfOne, Pair, Positive


class Sensor(Model):
    """A flat grid of square pixels."""

    pixels: Pair
    """Number of pixels: columns, rows."""
    pixel_mm: Positive
    """Width of a pixel, equal to the pixel pitch, in mm."""
    distance_mm: Positive | None = None
    """Distance to the sensor from the array's face nearest it, or from the last lens vertex without array, in mm.
    Omitted: the microlens focal plane; without array the image of `focus_mm`."""
    reflectance: FractionOfOne = 0.0
    """Share of the light that the pixels' surface reflects specularly at any angle; they detect the rest. Reflected
    light may return. All light beside the pixels is absorbed."""
    cover: Cover | None = None
    """Cover glass in front of the pixels, parallel to them. It fits between the array, or the lens, and the sensor and
    does not move the sensor. It moves the image away from the lens by t (1 - 1/n); an omitted `distance_mm` allows for
    this."""
    bands: Bands | None = None
    """Channels of the image, each a range of wavelengths: a list of bands, "rgb" or "xyz". "rgb": Gaussians at 600, 540
    and 460 nm, 90 nm wide at half maximum, which together reach from 380 to 735 nm. "xyz": the CIE 1931 colour-matching
    functions from 380 to 780 nm. A pixel's value is the spectral power weighted with the response. First-order optics
    uses the centroid of the first band's response. Omitted: single wavelengths, `transport.wavelengths_nm`."""
    pose: Pose = Field(default_factory=Pose)
    """Installation error: a motion about the sensor's centre."""

    def faults(self) -> Iterator[Fault]:
        """Yield faults of the bands and the cover."""
        if self.bands is not None:
            yield from band_faults(self.bands)
        if self.cover is not None and self.distance_mm is not None and self.cover.height_mm >= self.distance_mm:
            height, room = self.cover.height_mm, self.distance_mm
            yield Fault(
                ("cover", "thickness_mm"),
                self.cover.thickness_mm,
                f"with gap_mm = {self.cover.gap_mm:g} the cover begins {height:.6g} mm in front of the sensor, whose "
                f"distance_mm = {room:.6g}; thickness_mm and gap_mm together must be less",
            )

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height."""
        return self.pixels[0] * self.pixel_mm, self.pixels[1] * self.pixel_mm

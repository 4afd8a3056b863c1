"""The 4D light field: a view of the scene for every part of the exit pupil, with standard errors."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.lightfield.rays.ray_model import RayModel
from lfmesh.notebook import Pictured
from lfmesh.scene import Scene
from lfmesh.scene.literals import counted

if TYPE_CHECKING:
    import xarray

Array = NDArray[np.float64]
Samples = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class LightField(Pictured):
    """Samples of a light field, upright for an observer behind the camera.

    In object space, s grows to the right (+x) and t downwards (−y). u grows as the viewpoint in the entrance pupil
    moves to the right, v as it moves down. As u and v grow, objects nearer than the focus move towards smaller s and t.

    Attributes
    ----------
    data : (v, u, t, s, c) float32
        NaN outside the sensor or, after division by a white image, if that was dark.
    stderr : (v, u, t, s, c) float32
        Standard error of `data`, for independent pixels.
    v_rad, u_rad : (v,), (u,) float64
        Slope of each view at a lenslet against its chief ray; ascending, v_rad positive for views from −y and u_rad
        from +x in object space. Multiplied by the distance from exit pupil to array, it is a place on the exit pupil,
        except for its sign.
    t_mm, s_mm : (t,), (s,) float64
        Place on the array, from its middle; ascending, t_mm positive towards −y and s_mm towards +x in object space.
    wavelengths_nm : tuple of float
        One per channel.
    unit : str
        Of `data`: "W per pixel", or "W/(m² sr)" after division by the white image.
    scene : Scene
        Solved.
    sampling : str
        Relation of (t, s) to the lenslets, in words.
    sharing : (t, s) float32
        Variance of a mean over neighbouring views of a lenslet, over that of independent samples: above 1 because they
        share pixels, 1 if the centre falls on a pixel.
    """

    data: Samples
    stderr: Samples
    v_rad: Array
    u_rad: Array
    t_mm: Array
    s_mm: Array
    wavelengths_nm: tuple[float, ...]
    unit: str
    scene: Scene
    sampling: str
    sharing: Samples

    def __repr__(self) -> str:
        v, u, t, s, channels = self.data.shape
        return f"<LightField: {u} × {v} views of {s} × {t} samples, {counted(channels, 'wavelength')}, {self.unit}>"

    @cached_property
    def model(self) -> RayModel:
        """The camera's map between shift and distance, for photographs."""
        return RayModel.of(self.scene)

    @property
    def views(self) -> tuple[int, int]:
        """Number of views: rows, columns."""
        return self.data.shape[0], self.data.shape[1]

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of a view, in samples."""
        return self.data.shape[2], self.data.shape[3]

    @property
    def spacing_mm(self) -> tuple[float, float]:
        """Distance of neighbouring samples on the array, along t and s."""
        pitch = self.model.lenslet_pitch_mm
        return _step(self.t_mm, pitch), _step(self.s_mm, pitch)

    def view(self, v: int, u: int) -> Samples:
        """Return one view, (t, s, c).

        Parameters
        ----------
        v, u : int
            Row and column of the view, (0, 0) at the top left.

        Returns
        -------
        (t, s, c) float32
            In `unit`.

        Raises
        ------
        LfmeshError
            The view does not exist.
        """
        rows, columns = self.views
        _refuse_index("v", v, rows)
        _refuse_index("u", u, columns)
        return self.data[v, u]

    def epi(self, *, t: int | None = None, s: int | None = None, v: int | None = None, u: int | None = None) -> Samples:
        """Return an epipolar-plane image.

        Parameters
        ----------
        t, s : int
            Give one. A row `t` gives the horizontal EPI (u, s, c) of the views of row `v`, a column `s` the vertical
            EPI (v, t, c) of the views of column `u`.
        v, u : int, optional
            Default: the middle one.

        Returns
        -------
        (u, s, c) or (v, t, c) float32
            In `unit`.

        Raises
        ------
        LfmeshError
            Neither or both of t and s, or an index outside the light field.
        """
        if (t is None) == (s is None):
            raise LfmeshError(f"epi(t={t}, s={s}): give either a row t or a column s")
        rows, columns = self.views
        height, width = self.size
        if t is not None:
            row = rows // 2 if v is None else v
            _refuse_index("v", row, rows)
            _refuse_index("t", t, height)
            return self.data[row, :, t]
        assert s is not None
        column = columns // 2 if u is None else u
        _refuse_index("u", column, columns)
        _refuse_index("s", s, width)
        return self.data[:, column, :, s]

    def views_mosaic(self) -> Samples:
        """Return all views side by side.

        Returns
        -------
        (v·t, u·s, c) float32
            In `unit`.
        """
        return mosaic(self.data)

    def to_xarray(self) -> "xarray.Dataset":
        """Return data and standard error as an xarray Dataset with labelled axes.

        Returns
        -------
        xarray.Dataset

        Raises
        ------
        LfmeshError
            xarray is not installed.
        """
        try:
            import xarray
        except ImportError:
            raise LfmeshError("to_xarray needs the package xarray: pip install 'lfmesh[data]'") from None
        axes = ("v", "u", "t", "s", "wavelength")
        coordinates: dict[str, Any] = {
            "v": ("v", self.v_rad, {"unit": "rad", "long_name": "direction of the view, towards -y"}),
            "u": ("u", self.u_rad, {"unit": "rad", "long_name": "direction of the view, towards +x"}),
            "t": ("t", self.t_mm, {"unit": "mm", "long_name": "place on the array, towards -y in object space"}),
            "s": ("s", self.s_mm, {"unit": "mm", "long_name": "place on the array, towards +x in object space"}),
            "wavelength": ("wavelength", np.asarray(self.wavelengths_nm), {"unit": "nm"}),
        }
        values = {
            "data": (axes, self.data, {"unit": self.unit}),
            "stderr": (axes, self.stderr, {"unit": self.unit, "long_name": "standard error of data"}),
        }
        return xarray.Dataset(values, coordinates, {"name": self.scene.name, "sampling": self.sampling})


def mosaic(samples: Samples) -> Samples:
    """Return (v, u, t, s, c) samples as one picture (v·t, u·s, c)."""
    v, u, t, s, c = samples.shape
    return samples.transpose(0, 2, 1, 3, 4).reshape(v * t, u * s, c)


def from_mosaic(picture: Samples, views: tuple[int, int]) -> Samples:
    """Invert `mosaic`, given the number of views, rows and columns."""
    height, width, channels = picture.shape
    v, u = views
    return np.ascontiguousarray(picture.reshape(v, height // v, u, width // u, channels).transpose(0, 2, 1, 3, 4))


def _step(axis: Array, alone: float) -> float:
    return float(axis[1] - axis[0]) if len(axis) > 1 else alone


def _refuse_index(name: str, value: int, size: int) -> None:
    if not 0 <= value < size:
        raise LfmeshError(f"{name} = {value}: the light field has {name} from 0 to {size - 1}")

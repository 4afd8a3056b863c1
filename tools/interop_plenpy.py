"""Decode an export of `lfmesh export --format plenpy` with plenpy: run by tools/interop, in its own Python.

    python interop_plenpy.py EXPORT RESULT.npz

RESULT holds `centres` (n, 2): row, column; `view` (t, s): the middle view, linear; `spacing`: rows and columns of
its grid, in pixels; `views`: their number.
"""

import json
import sys
import warnings
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np

warnings.filterwarnings("ignore")
# A camera of plenpy that is not needed here imports torch, which fills a disk.
sys.modules.update({name: MagicMock() for name in ("torch", "torchvision", "torchvision.transforms")})

from plenpy.cameras.raytracer_lightfield_camera import RayTracerLF  # noqa: E402


def main(export: Path, result: Path) -> None:
    """Calibrate on the white image, by the method of Dansereau's toolbox, and decode the raw one."""
    camera = RayTracerLF(str(export), **json.loads((export / "camera.json").read_text()))
    camera.calibrate(method="dans", force=True)
    camera.load_sensor_image(0)
    camera.decode_sensor_image(0, resample_method="horizontal")
    field = np.asarray(camera.get_decoded_image(0))
    u, v = field.shape[:2]
    spacing = camera._calibrationDb[0]["ideal_grid_params"].spacing
    centres = camera.get_ml_centers(0)
    np.savez(result, centres=centres, view=field[u // 2, v // 2].mean(axis=-1), spacing=spacing, views=(u, v))


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve())

"""Render, export, and let PlenoptiCam and plenpy decode: their centres, views and planes of focus beside the truth.

Each decoder runs as a process of its own, in an environment of its own with the old libraries that it needs. The
environments are made with pip in a cache folder and used again, or in a temporary one.
"""

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import warnings
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.lightfield.rays.ray_model import RayModel

Array = NDArray[np.float64]

TOOLS = Path(__file__).resolve().parent

WRONG_INPUT = 2
NO_ENVIRONMENT = 3
"""Exit code where an environment cannot be made."""

PYTHON = "python3.11"
"""The newest that has wheels of the NumPy and SciPy which the decoders need."""

COMMON = ["numpy==1.24.*", "scipy==1.10.*", "scikit-image==0.21.*", "imageio==2.34.*", "colour-demosaicing==0.2.3",
          "colour-science<0.4.4"]  # fmt: skip
INSTALLATIONS = {
    # What it asks for beside includes an installer of applications and a withdrawn package.
    "plenopticam": [
        [*COMMON, "requests", "pillow"],
        ["--no-deps", "plenopticam==0.9.3", "color-matcher==0.4.0", "color-space-converter==0.1.4", "depthy==0.4.0"],
    ],
    "plenpy": [[*COMMON, "matplotlib<3.9", "plenpy==0.9.2"]],
}

SHIFT = 1.0 / 3.0
"""Of the target between neighbouring views, in lenslets: it lies out of focus, nearer than the camera's plane."""

VIEWS = 9
STOP_MM = 3.4
"""Semi-diameter; f/5.6 before lenslets of f/4 leaves the gaps between micro-images by which decoders find them."""


class NoEnvironmentError(Exception):
    """A decoder cannot be installed here."""


@dataclass(frozen=True)
class Result:
    """Result of a decoder for a raw image.

    Attributes
    ----------
    lenslets, found : int
        Of the camera; of them with a centre of the decoder's within half a pitch of the true one.
    mean_error_px, largest_error_px : float
        Distance of these centres from the true ones.
    view_correlation : float
        Normalised cross-correlation of the middle view with ours.
    target_mm : float
        Distance of the target.
    sharpest_mm : float or None
        Where the decoder's sharpest refocused picture lies, by the ray model; None if it does not refocus.
    """

    decoder: str
    layout: str
    lenslets: int
    found: int
    mean_error_px: float
    largest_error_px: float
    view_correlation: float
    target_mm: float
    sharpest_mm: float | None


def main() -> int:
    parser = argparse.ArgumentParser(prog="tools/interop", description=__doc__)
    parser.add_argument("decoders", nargs="*", metavar="DECODER", help=f"{' or '.join(INSTALLATIONS)}; both if omitted")
    parser.add_argument("--cache", type=Path, help="folder where the environments stay; temporary if omitted")
    parser.add_argument("--json", type=Path, help="file for the figures")
    parser.add_argument("--samples", type=int, default=32, help="per pixel")
    wanted = parser.parse_args()
    strangers = sorted(set(wanted.decoders) - set(INSTALLATIONS))
    if strangers:
        parser.error(f"{strangers[0]} is no decoder: choose from {', '.join(INSTALLATIONS)}")
    with tempfile.TemporaryDirectory(prefix="lfmesh-interop-") as folder:
        work = Path(folder)
        try:
            results = [
                measure(name, wanted.samples, (wanted.cache or work / "environments").resolve(), work)
                for name in wanted.decoders or INSTALLATIONS
            ]
        except NoEnvironmentError as error:
            print(f"tools/interop: {error}", file=sys.stderr)
            return NO_ENVIRONMENT
        except lf.LfmeshError as error:
            print(f"tools/interop: {error}", file=sys.stderr)
            return WRONG_INPUT
    print(table(results))
    if wanted.json is not None:
        wanted.json.write_text(json.dumps([asdict(result) for result in results], indent=2) + "\n")
    return 0


def measure(name: str, samples: int, cache: Path, work: Path) -> Result:
    """Render and export for one decoder, run it, and compare."""
    python = environment(name, cache)
    layout = "square" if name == "plenopticam" else "hexagonal"
    scene = camera(layout, samples)
    image, white, calibration = lf.render(scene), lf.white_image(scene), lf.calibrate(scene)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # the camera must be one that the decoder is said to manage
        lf.export_raw(image, white, calibration, work / name, name)
    found = decoded(python, name, work)
    errors = centre_errors(found["centres"][:, :2], calibration)
    field = lf.decode(image, white=white, calibration=calibration, views=VIEWS)
    middle = np.nan_to_num(field.view(VIEWS // 2, VIEWS // 2)).mean(axis=-1)
    return Result(
        decoder=name,
        layout=layout,
        lenslets=calibration.known.size,
        found=len(errors),
        mean_error_px=float(errors.mean()),
        largest_error_px=float(errors.max()),
        view_correlation=correlation(middle, found["view"]),
        target_mm=target_mm(scene),
        sharpest_mm=sharpest_mm(found["shifts"], found["stack"], field.model) if "stack" in found else None,
    )


def environment(name: str, cache: Path) -> Path:
    """Return the Python of a decoder's environment, made if it is not there."""
    home = cache / name
    python, done = home / "bin" / "python", home / "lfmesh-installed"
    wanted = json.dumps(INSTALLATIONS[name])
    if done.is_file() and done.read_text() == wanted:
        return python
    program = shutil.which(PYTHON)
    if program is None:
        raise NoEnvironmentError(f"{PYTHON} is not on the PATH; {name} needs it")
    print(f"installing {name}", file=sys.stderr)
    steps = [[program, "-m", "venv", "--clear", str(home)]]
    pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    steps += [[*pip, *packages] for packages in INSTALLATIONS[name]]
    for step in steps:
        ran = subprocess.run(step, capture_output=True, text=True)
        if ran.returncode:
            said = ran.stderr.strip().splitlines() or ["no reason given"]
            raise NoEnvironmentError(f"{name} cannot be installed: {said[-1]}")
    done.write_text(wanted)
    return python


def camera(layout: str, samples: int) -> lf.Scene:
    """Return 64 × 64 square lenslets of 10 pixels, or 60 × 70 hexagonal ones of 14, that see a chart out of focus."""
    square = layout == "square"
    array = {"layout": layout, "count": (64, 64) if square else (60, 70), "pitch_mm": 0.125, "focal_length_mm": 0.5}
    scene = lf.solved(
        lf.Scene(
            name=f"{layout} lenslets",
            camera={
                "focus_mm": 500.0,
                "lens": {
                    "file": asset_path("lenses/double_gauss_50mm.toml").as_posix(),
                    "stop_semi_diameter_mm": STOP_MM,
                },
                "mla": {**array, "index": 1.5, "thickness_mm": 0.3},
                "sensor": {
                    "pixels": (656, 656) if square else (870, 870),
                    "pixel_mm": 0.125 / (10 if square else 14),
                },
            },
            transport={"split": "transmit", "samples": samples, "replicates": 2},
        )
    )
    model = RayModel.of(scene)
    distance = model.distance_mm(SHIFT * model.lenslet_pitch_mm)
    width = 80.0 * model.object_scale(distance) / model.object_scale(500.0)
    chart = {
        "shape": {"kind": "plane", "width_mm": width, "height_mm": width},
        "position_mm": (0.0, 0.0, -distance),
        "material": {
            "reflectance": 0.0,
            "radiance_w_m2_sr": 1.0,
            "texture": asset_path("charts/chart.png").as_posix(),
        },
    }
    return scene.changed({"targets": [chart]})


def target_mm(scene: lf.Scene) -> float:
    return -scene.targets[0].position_mm[2]


def decoded(python: Path, name: str, work: Path) -> dict[str, Array]:
    """Run a decoder on its export and return what it found."""
    result = work / f"{name}.npz"
    driver = TOOLS / f"interop_{name}.py"
    ran = subprocess.run([python, driver, work / name, result], capture_output=True, text=True, cwd=work)
    if ran.returncode:
        raise SystemExit(f"tools/interop: {name} failed\n{ran.stdout[-2000:]}\n{ran.stderr[-4000:]}")
    with np.load(result) as arrays:
        return {key: arrays[key].astype(np.float64) for key in arrays.files}


def centre_errors(found: Array, calibration: lf.Calibration) -> Array:
    """Return the distance, in pixels, of the nearest found centre (row, column) for every lenslet that has one."""
    columns, _ = calibration.sensor_px
    # In the picture that decoders get: this camera's lens inverts, so columns are reversed.
    upright = np.array([columns - 1.0, 0.0]) + calibration.centres_px * [-1.0, 1.0]
    distances = np.array(
        [np.hypot(*(found[:, ::-1] - centre).T).min() for centre in upright[calibration.known]], dtype=np.float64
    )
    return distances[distances < 0.5 * calibration.pitch_px]


def correlation(ours: Array, theirs: Array) -> float:
    """Return the normalised cross-correlation of two views over the samples that both have, a border left out."""
    height, width = np.minimum(ours.shape, theirs.shape)
    inside = np.s_[height // 8 : height - height // 8, width // 8 : width - width // 8]
    a, b = ours[inside] - ours[inside].mean(), theirs[inside] - theirs[inside].mean()
    return float((a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum()))


def sharpest_mm(shifts: Array, stack: Array, model: RayModel) -> float:
    """Return the distance of the largest mean squared gradient; between pictures, a parabola through its logarithm."""
    height, width = stack.shape[1:]
    middle = stack[:, height // 4 : -height // 4, width // 4 : -width // 4]
    middle = middle / middle.mean(axis=(1, 2), keepdims=True)
    energy = np.log([sum((g**2).mean() for g in np.gradient(picture)) for picture in middle])
    best = int(np.clip(energy.argmax(), 1, len(energy) - 2))
    below, at, above = energy[best - 1 : best + 2]
    offset = 0.5 * (below - above) / (below - 2.0 * at + above)
    shift = shifts[best] + offset * (shifts[1] - shifts[0])
    return model.distance_mm(shift * model.lenslet_pitch_mm)


def table(results: list[Result]) -> str:
    """Return the results as Markdown."""
    heads = ["decoder", "lenslets", "centres found", "mean, largest error", "middle view against ours"]
    lines = [f"| {' | '.join(heads)} | target, sharpest plane |", "|---" * (len(heads) + 1) + "|"]
    for result in results:
        sharpest = f"{result.sharpest_mm:.1f} mm" if result.sharpest_mm is not None else "does not refocus"
        cells = [
            result.decoder,
            f"{result.lenslets} {result.layout}",
            str(result.found),
            f"{result.mean_error_px:.2f}, {result.largest_error_px:.2f} pixels",
            f"{result.view_correlation:.3f}",
            f"{result.target_mm:.1f} mm, {sharpest}",
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())

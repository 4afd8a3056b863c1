"""Decode an export of `lfmesh export --format plenopticam` with PlenoptiCam: run by tools/interop, in its own Python.

    python interop_plenopticam.py EXPORT RESULT.npz

RESULT holds `centres` (n, 4): row, column, lenslet row, lenslet column; `view` (t, s): the middle view, linear;
`shifts` and `stack` (n, t, s): refocused pictures by the shift between views, in lenslets.
"""

import sys
import warnings
from pathlib import Path

import numpy as np

warnings.filterwarnings("ignore")

from plenopticam import lfp_aligner, lfp_calibrator, lfp_extractor, lfp_reader, misc  # noqa: E402
from plenopticam.cfg import PlenopticamConfig  # noqa: E402
from plenopticam.lfp_refocuser.lfp_shiftandsum import LfpShiftAndSum  # noqa: E402

SHIFTS = (-1, 1)
"""Of the refocused pictures, in lenslets; with its refinement in steps of one over the number of views."""


def main(export: Path, result: Path) -> None:
    """Do what PlenoptiCam's own command line does, which cannot be called where there is no tkinter."""
    config, status = PlenopticamConfig(), misc.PlenopticamStatus()
    config.read_params(str(export / "settings.json"))
    settings = config.params
    for path in (config.lfp_path, config.cal_path):
        settings[path] = str(export / settings[path])
    settings[config.ran_refo], settings[config.opt_refi] = list(SHIFTS), True

    reader = lfp_reader.LfpReader(config, status)
    reader.main()
    misc.mkdir_p(config.exp_path, False)
    white = misc.load_img_file(settings[config.cal_path])
    calibrator = lfp_calibrator.LfpCalibrator(white, config, status)
    calibrator.main()
    config = calibrator.cfg
    config.load_cal_data()
    centres = np.array(config.calibs[config.mic_list], dtype=np.float64)

    aligner = lfp_aligner.LfpAligner(reader.lfp_img, config, status, white)
    aligner.main()
    extractor = lfp_extractor.LfpExtractor(aligner.lfp_img, cfg=config, sta=status)
    extractor.main()
    views = np.asarray(extractor.vp_img_linear)
    refocuser = LfpShiftAndSum(vp_img_arr=extractor.vp_img_linear, cfg=config, sta=status)
    refocuser.main()
    stack = np.asarray(refocuser.refo_stack)[..., 0]
    count = len(views)
    shifts = np.arange(SHIFTS[0] * count, SHIFTS[1] * count) / count
    np.savez(result, centres=centres, view=views[count // 2, count // 2, :, :, 0], shifts=shifts, stack=stack)


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve())

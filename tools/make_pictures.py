"""Make the pictures of the README from a run of the demo: tools/run demo -o run, then tools/make_pictures.py run."""

import sys
from pathlib import Path

from PIL import Image

PICTURES = Path(__file__).resolve().parent.parent / "assets" / "pictures"
SIDE_PX = 320
DETAIL_PX = 80
"""Eight lenslets, enlarged to the side of the other pictures."""
DETAIL_CORNER = (280, 160)


def main(run: Path) -> None:
    """Write the raw image, a detail of it, and the view, all of one size."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    with Image.open(run / "preview.png") as raw, Image.open(run / "preview_view.png") as view:
        x, y = DETAIL_CORNER
        detail = raw.crop((x, y, x + DETAIL_PX, y + DETAIL_PX)).resize((SIDE_PX, SIDE_PX), Image.Resampling.NEAREST)
        detail.save(PICTURES / "micro_images.png", optimize=True)
        raw.crop((160, 160, 160 + SIDE_PX, 160 + SIDE_PX)).save(PICTURES / "raw.png", optimize=True)
        view.resize((SIDE_PX, SIDE_PX), Image.Resampling.LANCZOS).save(PICTURES / "view.png", optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))

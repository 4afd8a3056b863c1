"""Write assets/lenses/index.txt, which `lfmesh lens list` prints: a line for each lens that comes with lfmesh.

    .venv/bin/python tools/make_lens_index.py

To be run after a lens was added or changed; a test compares the file with the lenses.
"""

from pathlib import Path

from lfmesh.scene.lens_library import entries

INDEX = Path(__file__).resolve().parents[1] / "assets" / "lenses" / "index.txt"

if __name__ == "__main__":
    INDEX.write_text("".join(f"{entry}\n" for entry in entries()), encoding="utf-8")

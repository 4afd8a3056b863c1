"""``python -m lfmesh``: same as the command ``lfmesh``."""

from lfmesh.cli import main

if __name__ == "__main__":
    raise SystemExit(main())

"""Reads VTK image data in a process of its own, which VTK's reader may take with it on a damaged file.

It is run as a script, with the path of the file and a limit of its memory in bytes, and ends with 0 if it lives.
"""

import sys
from contextlib import suppress


def main(arguments: list[str]) -> None:
    """Read a file, and let go what is in it."""
    from vtkmodules.vtkIOXML import vtkXMLImageDataReader

    # Not to be had on Windows.
    with suppress(ImportError):
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (int(arguments[1]), int(arguments[1])))
    reader = vtkXMLImageDataReader()
    reader.SetFileName(arguments[0])
    reader.Update()


if __name__ == "__main__":
    main(sys.argv[1:])

"""Trial reader of VTK image data in a separate process, as damaged files may crash VTK's reader.

Run as a script with a path and a memory limit in bytes; exits with 0 if it survives.
"""

import sys
from contextlib import suppress


def main(arguments: list[str]) -> None:
    """Read a file and discard its content."""
    from vtkmodules.vtkIOXML import vtkXMLImageDataReader

    # Unavailable on Windows.
    with suppress(ImportError):
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (int(arguments[1]), int(arguments[1])))
    reader = vtkXMLImageDataReader()
    reader.SetFileName(arguments[0])
    reader.Update()


if __name__ == "__main__":
    main(sys.argv[1:])

"""Trial reader of VTK image data and of flows in a separate process, as damaged files may crash VTK's readers.

Run as a script with a path and a memory limit in bytes, and "flow" for a flow; exits with 0 if it survives.
"""

import sys
from contextlib import suppress


def main(arguments: list[str]) -> None:
    """Read a file and discard its content."""
    # Unavailable on Windows.
    with suppress(ImportError):
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (int(arguments[1]), int(arguments[1])))
    if arguments[2:] == ["flow"]:
        import pyvista

        pyvista.get_reader(arguments[0]).read()
        return
    from vtkmodules.vtkIOXML import vtkXMLImageDataReader

    reader = vtkXMLImageDataReader()
    reader.SetFileName(arguments[0])
    reader.Update()


if __name__ == "__main__":
    main(sys.argv[1:])

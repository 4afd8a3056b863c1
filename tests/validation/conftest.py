"""What several validations share."""

import pytest


@pytest.fixture(scope="module")
def gmsh():
    """The CAD kernel that writes lenses; it is a tool of tests alone."""
    module = pytest.importorskip("gmsh", reason="gmsh is not there; tools/test --long installs it")
    module.initialize()
    module.option.setNumber("General.Terminal", 0)
    yield module
    module.finalize()

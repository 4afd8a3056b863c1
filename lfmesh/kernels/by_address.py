"""Named tuples that kernels receive as the address of a block of memory.

By itself numba passes every field of a named tuple as arguments of their own: a kernel that takes the tables of a scene
has hundreds, which are packed and unpacked at every call within it, and each use of a field begins with all of them.
Where numba's private classes are not as expected, that is what happens.
"""

from typing import Any, TypeVar

from numba.extending import typeof_impl

from lfmesh.kernels.accelerator import private

Class = TypeVar("Class", bound=type)


def by_address(made_from: Class) -> Class:
    """Let kernels receive the named tuples of a class by their address, with those that are among their fields."""

    @typeof_impl.register(made_from)  # type: ignore[untyped-decorator]
    def type_of(value: Any, context: Any) -> Any:
        tables = private("tables")
        table = None if tables is None else tables.type_of(value, context)
        return typeof_impl.dispatch(tuple)(value, context) if table is None else table

    return made_from

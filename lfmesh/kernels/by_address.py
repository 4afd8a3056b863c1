"""Named tuples that kernels receive as the address of a block of memory.

Numba alone passes every field of a named tuple as a separate argument. A kernel that takes the tables of a scene then
has hundreds of arguments, packed and unpacked at every call. This happens if numba's private classes are unused.
"""

from typing import Any, TypeVar

from numba.extending import typeof_impl

from lfmesh.kernels.accelerator import private

Class = TypeVar("Class", bound=type)


def by_address(made_from: Class) -> Class:
    """Let kernels receive the named tuples of a class, and those among their fields, by address."""

    @typeof_impl.register(made_from)  # type: ignore[untyped-decorator]
    def type_of(value: Any, context: Any) -> Any:
        tables = private("tables")
        table = None if tables is None else tables.type_of(value, context)
        return typeof_impl.dispatch(tuple)(value, context) if table is None else table

    return made_from

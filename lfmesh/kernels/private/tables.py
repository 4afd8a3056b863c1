"""Numba types and memory layout of tables, the named tuples of classes marked with `by_address`.

The fields are written to memory once, when Python calls the kernel. All functions that it calls receive the address and
read the fields that they use. Kernels never change this memory; LLVM is told so and avoids repeated reads. A tuple that
a kernel itself makes is an ordinary tuple.
"""

import hashlib
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.datamodel import default_manager, models
from numba.core.pythonapi import PythonAPI
from numba.core.typing.templates import AttributeTemplate
from numba.core.typing.typeof import Purpose
from numba.extending import (
    NativeValue,
    infer_getattr,
    lower_getattr_generic,
    register_model,
    typeof_impl,
    unbox,
)

from lfmesh.kernels.private.expected import require

_ARGUMENT = Purpose.argument

_WORD = 8
# Unit of memory, in bytes; a structure, so that LLVM's type of an address identifies a table.
_UNIT = ir.LiteralStructType([ir.IntType(8 * _WORD)])
_INDEX = ir.IntType(32)
_OF_ARRAY = ["meminfo", "parent", "nitems", "itemsize", "data", "shape", "strides"]
"""Parts of an array in memory, one word each; the last two have one word per dimension."""


class Table(types.Type):  # type: ignore[misc]
    """Type of a named tuple that is passed by its address."""

    def __init__(self, made_from: type, members: tuple[types.Type, ...]) -> None:
        self.made_from = made_from
        self.members = dict(zip(made_from._fields, members, strict=True))  # type: ignore[attr-defined]
        offset = 0
        self.offsets = {}
        for name, member in self.members.items():
            self.offsets[name] = offset
            offset += _size(member)
        self.size = offset
        # A digest represents the many types of the fields, as numba compares and hashes types all the time.
        self.digest = hashlib.sha256(repr(self.members).encode()).hexdigest()
        # Short but unique, as it is part of the names of all functions that take the table.
        super().__init__(f"{made_from.__qualname__}({self.digest[:16]})")

    @property
    def key(self) -> tuple[type, str]:
        """Key that identifies the type."""
        return self.made_from, self.digest


def type_of(value: Any, context: Any) -> "Table | None":
    """Return the type of a named tuple that is passed by its address, or None for an ordinary tuple.

    Parameters
    ----------
    value : tuple
    context : numba.core.typing.typeof._TypeofContext
    """
    # A module's constant has a different address in every process.
    return _table(value, context) if context.purpose is _ARGUMENT else None


def _table(value: Any, context: Any) -> Table | None:
    """Return the type of a named tuple that is passed by its address."""
    members = [_table(each, context) if hasattr(each, "_fields") else typeof_impl(each, context) for each in value]
    return None if None in members else Table(type(value), tuple(map(types.unliteral, members)))


def _size(member: types.Type) -> int:
    """Return the number of bytes of a field, a multiple of a word."""
    if isinstance(member, types.NoneType):
        return 0
    if isinstance(member, Table):
        return member.size
    if isinstance(member, types.Array):
        return (len(_OF_ARRAY) - 2 + 2 * member.ndim) * _WORD
    if isinstance(member, types.Boolean | types.Integer | types.Float):
        return _WORD
    raise TypeError(f"a field of a table that is passed by its address is {member}")


@register_model(Table)
class _TableModel(models.PrimitiveModel):  # type: ignore[misc]
    """Table in a kernel: an address."""

    def __init__(self, manager: Any, table: Table) -> None:
        super().__init__(manager, table, _block(table).as_pointer())


@infer_getattr
class _FieldTypes(AttributeTemplate):  # type: ignore[misc]
    key = Table

    def generic_resolve(self, table: Table, name: str) -> types.Type | None:
        """Return the type of a field."""
        return table.members.get(name)


@lower_getattr_generic(Table)  # type: ignore[untyped-decorator]
def _read(context: Any, builder: Any, table: Table, address: Any, name: str) -> Any:
    """Read a field."""
    member = table.members[name]
    if isinstance(member, types.NoneType):
        return context.get_dummy_value()
    place = _at(context, builder, address, table, name)
    if isinstance(member, Table):
        return place
    value = builder.load(place, align=_WORD)
    # Numba alone makes a truth value of a byte with two branches.
    return builder.icmp_unsigned("!=", value, value.type(0)) if isinstance(member, types.Boolean) else value


@unbox(Table)  # type: ignore[untyped-decorator]
def _write(table: Table, tuple_: Any, c: Any) -> NativeValue:
    """Write a Python named tuple to memory."""
    address = cgutils.alloca_once(c.builder, _block(table))
    failed = _write_fields(table, tuple_, c, address)
    with c.builder.if_then(failed, likely=False):
        c.pyapi.err_set_string("PyExc_TypeError", f"cannot read a {table.made_from.__name__}")
    return NativeValue(address, is_error=failed)


def _write_fields(table: Table, tuple_: Any, c: Any, address: Any) -> Any:
    """Write the fields of a named tuple to an address; return whether any has the wrong type."""
    failed = cgutils.false_bit
    for i, (name, member) in enumerate(table.members.items()):
        if isinstance(member, types.NoneType):
            continue
        value = c.pyapi.tuple_getitem(tuple_, i)
        place = _at(c.context, c.builder, address, table, name)
        if isinstance(member, Table):
            wrong = _write_fields(member, value, c, place)
        elif isinstance(member, types.Array):
            # No reference counts: the tuple holds its arrays for the whole call.
            kind = ir.FunctionType(ir.IntType(32), [c.pyapi.pyobj, c.pyapi.voidptr])
            adapt = cgutils.get_or_insert_function(c.builder.module, kind, "numba_adapt_ndarray")
            code = c.builder.call(adapt, (value, c.builder.bitcast(place, c.pyapi.voidptr)))
            wrong = cgutils.is_not_null(c.builder, code)
        else:
            native = c.unbox(member, value)
            c.builder.store(c.context.data_model_manager[member].as_data(c.builder, native.value), place)
            wrong = native.is_error
        failed = c.builder.or_(failed, wrong)
    return failed


def _at(context: Any, builder: Any, address: Any, table: Table, name: str) -> Any:
    """Return the address of a field."""
    member = table.members[name]
    kind = _block(member) if isinstance(member, Table) else context.get_data_type(member)
    place = builder.gep(address, [_INDEX(0), _INDEX(table.offsets[name] // _WORD)], inbounds=True)
    return builder.bitcast(place, kind.as_pointer())


def _block(table: Table) -> ir.ArrayType:
    """Return the type of a table's memory."""
    return ir.ArrayType(_UNIT, table.size // _WORD)


def promise_unchanged(function: Any) -> None:
    """Tell LLVM that kernels neither change the tables among a function's arguments nor keep their addresses."""
    for argument in function.args:
        if argument.name.startswith("arg.") and _is_address(argument.type):
            # `set.update`, as llvmlite rejects some attributes that LLVM knows.
            set.update(argument.attributes, ("noalias", "readonly", "captures(none)"))
            argument.attributes.dereferenceable = argument.type.pointee.count * _WORD
            argument.attributes.align = _WORD


def _is_address(kind: ir.Type) -> bool:
    """Tell whether an LLVM type is the address of a table."""
    return isinstance(kind, ir.PointerType) and isinstance(kind.pointee, ir.ArrayType) and kind.pointee.element == _UNIT


def probe() -> None:
    """Raise AttributeError if numba's arrays have another memory layout, or functions that write tables are missing."""
    require(cgutils, "alloca_once", "get_or_insert_function", "is_not_null", "false_bit")
    require(PythonAPI, "tuple_getitem", "err_set_string")
    fields = [*models.ArrayModel(default_manager, types.Array(types.float64, 1, "C"))._fields]
    if fields != _OF_ARRAY:
        raise AttributeError(f"an array in memory is {', '.join(fields)}")

"""Machine instructions that numba does not offer: atomic operations and prefetching.

Several threads may apply an atomic operation to the same entry of an array. Each receives the entry before its own
operation.
"""

from __future__ import annotations

from typing import Any

from ...system.jit import intrinsic


@intrinsic
def fetch_or(typing: Any, array: Any, place: Any, bits: Any) -> Any:  # noqa: ARG001
    """Execute `array[place] |= bits` atomically; return the previous word."""
    from numba import types  # here and below, since these functions run when others are compiled

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        return builder.atomic_rmw("or", builder.gep(data, [arguments[1]]), arguments[2], "monotonic")

    return types.uint64(array, types.int64, types.uint64), code


@intrinsic
def fetch_min(typing: Any, array: Any, place: Any, value: Any) -> Any:  # noqa: ARG001
    """Execute `array[place] = min(array[place], value)` atomically; return the previous entry."""
    from numba import types

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        pointer = builder.gep(data, [arguments[1]])
        value = context.cast(builder, arguments[2], signature.args[2], signature.args[0].dtype)
        return builder.atomic_rmw("umin", pointer, value, "monotonic")

    return array.dtype(array, types.int64, value), code


@intrinsic
def prefetch(typing: Any, array: Any, place: Any) -> Any:  # noqa: ARG001
    """Start to load an entry into the cache, without waiting."""
    from llvmlite import ir
    from numba import types
    from numba.core import cgutils

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        pointer = builder.bitcast(builder.gep(data, [arguments[1]]), cgutils.voidptr_t)
        number = ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [cgutils.voidptr_t, number, number, number])
        prefetch = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
        builder.call(prefetch, [pointer, number(0), number(3), number(1)])
        return context.get_dummy_value()

    return types.void(array, types.int64), code


@intrinsic
def lowest_bit(typing: Any, word: Any) -> Any:  # noqa: ARG001
    """Return the position of the lowest set bit of a nonzero word."""
    from llvmlite import ir
    from numba import types

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001
        return builder.cttz(arguments[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.uint64), code

"""Compilation of loops over arrays to machine code.

numba compiles a function at its first call and stores the machine code beside the module, or in the user's cache folder
if the module's folder cannot be written. The stored code is renewed when the module of the function changes. Compiled
functions therefore call only compiled functions of their own module.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """Compile a function at its first call.

    It runs without Python's global lock. Sums are evaluated in the written order.
    """
    options = {"nogil": True, "error_model": "numpy"}
    try:
        return numba.njit(cache=True, **options)(function)
    except RuntimeError:  # numba finds no folder that it may write
        return numba.njit(**options)(function)

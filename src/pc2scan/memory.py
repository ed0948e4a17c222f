"""Makes the allocator keep freed memory for the next cloud instead of returning it to the system.

This changes the allocator of the whole process. So only the command does it, and never the library, which may run in
another program's process.
"""

from __future__ import annotations

import ctypes

#: Parameters of mallopt, from glibc's malloc.h.
_M_TRIM_THRESHOLD = -1
_M_TOP_PAD = -2
_M_MMAP_THRESHOLD = -3

#: Freed buffers up to this size are kept: most clouds and chunks are smaller. To keep larger ones would fragment the
#: memory.
_MMAP_FROM_BYTES = 20 << 20
_KEPT_BYTES = 64 << 20
_GROWN_BY_BYTES = 16 << 20


def keep_freed_memory() -> bool:
    """Make glibc's malloc keep freed memory.

    By default it returns a buffer of a chunk's size to the system when it is freed, and the system has to provide and
    clear every page of the next one.

    Returns
    -------
    bool
        Whether the setting was made; False if the C library is not glibc, which only costs time.
    """
    try:
        library = ctypes.CDLL(None)
        # In other C libraries, the same parameters mean something else.
        _, mallopt = library.gnu_get_libc_version, library.mallopt
    except (OSError, TypeError, AttributeError):
        return False
    settings = (
        (_M_MMAP_THRESHOLD, _MMAP_FROM_BYTES),
        (_M_TRIM_THRESHOLD, _KEPT_BYTES),
        (_M_TOP_PAD, _GROWN_BY_BYTES),
    )
    return all(mallopt(name, value) == 1 for name, value in settings)

"""How a process that handles large images asks the kernel for memory."""

from __future__ import annotations

import ctypes

# Of glibc's malloc.h.
_M_TRIM_THRESHOLD = -1
_M_MMAP_THRESHOLD = -3
_M_ARENA_MAX = -8
# Buffers up to this many bytes, an 8K image in grey, are cut from the heap; malloc takes no more.
_MAX_KEPT = 2**25
# So many free bytes at the end of a heap are kept: what a few large images in work take.
_MAX_FREE = 2**28


def keep_large_buffers() -> None:
    """Let freed images be used again, in place of new memory from the kernel for each.

    By default glibc gives large buffers back when they are freed. Each frame's new ones are then
    mapped, cleared and faulted in page by page, which costs more than all copying of a frame. And
    each thread gets a heap of its own, so that what one receives is no use to the next.
    Other C libraries are left as they are.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except AttributeError:
        return
    mallopt(_M_MMAP_THRESHOLD, _MAX_KEPT)
    mallopt(_M_TRIM_THRESHOLD, _MAX_FREE)
    mallopt(_M_ARENA_MAX, 1)

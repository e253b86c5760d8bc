"""Reuse of freed memory between training steps."""

import ctypes
import sys

# Options of glibc's malloc.h: free bytes at the end of a heap above which memory is returned to the system; bytes by
# which a heap grows; size from which an array gets memory outside of the heap.
_TRIM_THRESHOLD, _TOP_PAD, _MMAP_THRESHOLD = -1, -2, -3


def keep_freed_memory(keep: bool = True) -> bool:
    """Let glibc keep freed memory instead of returning it to the system.

    On a CPU, XLA allocates the arrays of each step anew. By default glibc returns them to the system after the step,
    and the next gets them page by page and zeroed. That takes 2 to 4 % of the time with 25 steps in a call
    (`benches/memory.py`), and an eighth with one. Results are the same, bit for bit; the process keeps its largest
    size.

    Args:
        keep: false restores the default of glibc.

    Returns:
        whether the C library is glibc and accepted the options.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform.startswith("linux") else None
    if mallopt is None:
        return False
    default = 2**17
    accepted = [
        mallopt(_MMAP_THRESHOLD, 2**30 if keep else default),
        mallopt(_TRIM_THRESHOLD, 2**31 - 1 if keep else default),
        mallopt(_TOP_PAD, 2**28 if keep else default),
    ]
    return all(accepted)

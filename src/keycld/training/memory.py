"""Memory that one training step frees serves the next one."""

import ctypes
import sys

# Of glibc's malloc.h: bytes of free memory at a heap's end that are handed back; bytes by which a heap grows; from how
# many bytes on an array is no part of a heap.
_TRIM_THRESHOLD, _TOP_PAD, _MMAP_THRESHOLD = -1, -2, -3


def keep_freed_memory(keep: bool = True) -> bool:
    """Let glibc keep freed memory instead of handing it back to the system; whether there is a glibc to tell.

    On a CPU XLA allocates the arrays of a step anew each time. By default glibc hands them back after the step, and the
    next one gets them page by page and zeroed: 9,000 page faults and an eighth of a step's time (`benches/memory.py`).
    The numbers stay the same, bit for bit; the process stays as large as it ever was.

    Args:
        keep: false: as glibc does by default.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform.startswith("linux") else None
    if mallopt is None:
        return False
    usual = 2**17
    told = [
        mallopt(_MMAP_THRESHOLD, 2**30 if keep else usual),
        mallopt(_TRIM_THRESHOLD, 2**31 - 1 if keep else usual),
        mallopt(_TOP_PAD, 2**28 if keep else usual),
    ]
    return all(told)

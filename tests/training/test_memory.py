"""Memory that the process keeps between training steps."""

import platform
import subprocess
import sys

# In its own process, because arrays could reuse memory that other tests have freed. `mallinfo2` is in glibc's malloc.h.
SCRIPT = """
import ctypes
import numpy as np
from keycld.training.memory import keep_freed_memory

class Mallinfo2(ctypes.Structure):
    names = "arena ordblks smblks hblks hblkhd usmblks fsmblks uordblks fordblks keepcost"
    _fields_ = [(name, ctypes.c_size_t) for name in names.split()]

count = ctypes.CDLL(None).mallinfo2
count.restype = Mallinfo2
for keep in (False, True):
    accepted = keep_freed_memory(keep)
    before = count()
    array = np.empty(2**26, np.uint8)
    during = count()
    del array
    print(accepted, during.hblks - before.hblks, during.arena - count().arena)
"""


def test_kept_memory_is_not_returned_to_the_system():
    """An array of 64 megabytes, made and dropped, as in each training step."""
    run = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=False)
    if platform.libc_ver()[0] == "glibc":
        # By default the array is mapped on its own; then it is part of the heap, which keeps its size.
        assert run.stdout.split("\n") == ["True 1 0", "True 0 0", ""], run.stderr
    else:
        assert "mallinfo2" in run.stderr  # another C library has no such count and is not changed

"""The main program of a worker process: takes tasks from stdin, answers on stdout, ends with its parent."""

import os
import sys
import threading
import time
import traceback
from multiprocessing.connection import Connection

from keycld._errors import KeycldError


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(0.2)
    os._exit(1)


def main() -> None:
    """Run tasks until the parent process, whose id is the first argument, has ended."""
    threading.Thread(target=_end_with, args=(int(sys.argv[1]),), daemon=True).start()
    tasks = Connection(os.dup(0), writable=False)
    answers = Connection(os.dup(1), readable=False)
    os.dup2(2, 1)  # what a library prints must not get between the answers
    while True:
        try:
            function, arguments = tasks.recv()
        except EOFError:
            return
        except (AttributeError, ImportError) as error:
            answers.send(KeycldError(f"{error}: a system must be in a module that other processes can import."))
            continue
        try:
            answer = function(*arguments)
        except KeycldError as error:
            answer = error
        except OSError as error:
            answer = OSError(error.errno, error.strerror, error.filename)
        except Exception as error:
            answer = RuntimeError(f"{type(error).__name__} in a worker process: {error}\n{traceback.format_exc()}")
        try:
            answers.send(answer)
        except BrokenPipeError:
            return


if __name__ == "__main__":
    main()
